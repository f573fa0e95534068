"""The frames of a recording in MCAP: our own, with times and poses,
or the images of Foxglove or ROS 2.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Final

import cv2
import msgspec
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError as ProtobufError
from mcap.records import Channel, Message, Schema
from msgspec import Meta

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.image_bytes import PIXELS_MAX, SIDE_MAX_PX, decode_image
from tacshade_edge.files.tables import NUMBER_MAX
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.recording.frame_table import ERROR_US_MAX, T_NS_MAX, UNIT_TOLERANCE, TableRow
from tacshade_edge.recording.mcap import ros_image
from tacshade_edge.recording.mcap.reader import McapFile
from tacshade_edge.recording.mcap.ros_image import PixelRows
from tacshade_edge.types import U8, Pose

OURS: Final = "tacshade"
"""Key in a channel's metadata with the value `CAMERA` or `FRAME`;
the `FRAME` channel holds times and poses.
"""
CAMERA, FRAME = "camera", "frame"
POSE_KEYS: Final = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
_ABOUT_BYTES_MAX: Final = 1 << 16
_NAME_CHARS_MAX: Final = 255
_UNUSABLE_MAX: Final = 10_000
"""Most unusable pictures and damaged places in a pass;
each costs a log line, and a small file can have millions.
"""
Picture = Callable[[], U8]


_Value = Annotated[float, Meta(ge=-NUMBER_MAX, le=NUMBER_MAX)] | None


class FrameAbout(msgspec.Struct, frozen=True, kw_only=True):
    """The content of a `FRAME` message: what is known of the next image."""

    image: Annotated[str, Meta(max_length=_NAME_CHARS_MAX)]
    seq: int
    t_ns: Annotated[int, Meta(ge=0, le=T_NS_MAX)]
    x_mm: _Value = None
    y_mm: _Value = None
    z_mm: _Value = None
    qw: _Value = None
    qx: _Value = None
    qy: _Value = None
    qz: _Value = None
    pose_error_us: Annotated[int, Meta(ge=0, le=ERROR_US_MAX)] | None = None


_Image = tuple[str, str, Message, FrameAbout | str | None]
"""A message of an image: its schema and encoding,
and the content of our `FRAME` message before it.
"""


class McapFrames:
    """The images of a recording, whose files are in order; leaves out those that are not MCAP, if
    others are. `damage` is of everything but frames, for a person. `length_ns` is from the first to
    the last message on any topic, 0 if a file does not state it.

    Raises ConfigError if it does not have exactly one readable topic of images.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths: list[Path] = []
        self.cut_off = False
        damage, spans = [], []
        for path in paths:
            try:
                with contextlib.closing(McapFile(path)) as file:
                    self.cut_off = self.cut_off or file.cut_off
                    spans.append(file.summary.span_ns if file.summary else None)
                    damage.extend([file.damage] if file.damage else [])
            except ConfigError as error:  # with several files, the others still have frames
                if len(paths) == 1:
                    raise
                damage.append(f"{error}; leaving its frames out")
                continue
            self._paths.append(path)
        # Unknown as soon as one file does not state its own.
        stated = [span for span in spans if span is not None]
        self.length_ns = (
            max(0, stated[-1][1] - stated[0][0]) if stated and len(stated) == len(paths) else 0
        )
        self.damage = "; ".join(damage)
        self.topic, self._is_ours = _topic_of(self._paths or paths)
        self._unusable = 0

    def __iter__(self) -> Iterator[tuple[TableRow, Picture, int]]:
        """Every frame's row, its picture, which raises DecodeError if it is unusable,
        and its message's time in ns.
        """
        last_ns = -1
        self._unusable = 0
        # Numbered over all files, as are the frames.
        images = ((path, found) for path in self._paths for found in self._images_in(path))
        for count, (path, found) in enumerate(images):
            where, too_many = "", self._unusable > _UNUSABLE_MAX
            try:
                if too_many:
                    unusable = (
                        f"found {self._unusable} unusable messages; skipping all later messages"
                    )
                    raise DecodeError(f"{shown(self.topic)}: {unusable}")
                if isinstance(found, DecodeError):
                    raise found
                where = f"{shown(path)}: message {count} of {shown(self.topic)}: "
                schema, encoding, message, about = found
                row = self._row(count, message, about)
                if row.t_ns <= last_ns:
                    expected = f"expected a time after the previous frame's, {last_ns} ns"
                    raise DecodeError(f"found the time {row.t_ns} ns, {expected}")
            except DecodeError as error:
                yield TableRow(str(count), max(last_ns, 0), None), self._picture(where, error), 0
                if too_many:
                    return
                continue
            last_ns = row.t_ns
            yield row, self._picture(where, (schema, encoding, message.data)), message.log_time

    def _picture(self, where: str, content: tuple[str, str, bytes] | DecodeError) -> Picture:
        def picture() -> U8:
            try:
                if isinstance(content, DecodeError):
                    raise content
                return image_of(*content)
            except DecodeError as error:
                self._unusable += 1
                raise DecodeError(f"{where}{error}") from None

        return picture

    def _images_in(self, path: Path) -> Iterator[_Image | DecodeError]:
        with contextlib.closing(McapFile(path)) as file:
            # The first of each id counts, because our writer repeats them and all copies are equal.
            # From the index, too: the chunk that describes them may be damaged.
            schemas = dict(file.summary.schemas) if file.summary else {}
            channels = dict(file.summary.channels) if file.summary else {}
            about: FrameAbout | str | None = None
            images = damaged = unknown = 0
            for record in file.records():
                match record:
                    case Schema():
                        schemas.setdefault(record.id, record)
                    case Channel():
                        channels.setdefault(record.id, record)
                    case DecodeError():
                        damaged += 1
                        yield record
                    case Message():
                        channel = channels.get(record.channel_id)
                        if channel is None:
                            unknown += 1
                        # Our writer puts what is known of a frame before its image.
                        elif channel.metadata.get(OURS) == FRAME:
                            about = _about(record.data)
                        elif channel.topic == self.topic:
                            images += 1
                            schema = schemas.get(channel.schema_id)
                            yield (
                                schema.name if schema else "",
                                channel.message_encoding,
                                record,
                                about,
                            )
            if unknown:
                found = f"{unknown} messages on channels that the file does not describe"
                yield DecodeError(f"{shown(path)}: found {found}; skipping these messages")
            counts = file.summary.counts if file.summary else {}
            expected = sum(
                counts.get(channel.id, 0)
                for channel in channels.values()
                if channel.topic == self.topic
            )
            if expected - images > damaged:
                found = (
                    f"{images} messages on {shown(self.topic)}, expected {expected}, "
                    "as in the file's index"
                )
                yield DecodeError(f"{shown(path)}: found {found}; the missing messages are lost")

    def _row(self, count: int, message: Message, about: FrameAbout | str | None) -> TableRow:
        """The row of a message, from our `FRAME` message or else from the message's time.

        Raises DecodeError.
        """
        if not self._is_ours:
            if message.log_time > T_NS_MAX:
                raise DecodeError(f"found the time {message.log_time}, expected at most 2^62 ns")
            return TableRow(str(count), message.log_time, None)
        if isinstance(about, str):
            raise DecodeError(about)
        # Damage may have taken either of the two: they have one number.
        if about is None or about.seq != message.sequence:
            raise DecodeError(
                "found no message with this image's time, expected one on the channel `frame` "
                "before the image"
            )
        stated = {key: value for key in POSE_KEYS if (value := getattr(about, key)) is not None}
        if not stated:
            return TableRow(about.image, about.t_ns, None)
        if len(stated) < len(POSE_KEYS) or about.pose_error_us is None:
            raise DecodeError(
                f"found only {', '.join(stated)} of a pose, "
                "expected all its values and pose_error_us"
            )
        pose = Pose(about.t_ns, **stated)
        if abs((norm := math.hypot(pose.qw, pose.qx, pose.qy, pose.qz)) - 1) > UNIT_TOLERANCE:
            raise DecodeError(
                f"qw, qx, qy, qz: found a quaternion of length {norm:.4g}, expected length 1"
            )
        return TableRow(about.image, about.t_ns, pose, about.pose_error_us)


def _topic_of(paths: Sequence[Path]) -> tuple[str, bool]:
    """Our topic of images, or the only one there is, and whether it is ours. Raises ConfigError."""
    topics: set[str] = set()
    damage = ""
    for path in paths:
        with contextlib.closing(McapFile(path)) as file:
            schemas: dict[int, Schema] = {}
            described = (
                (*file.summary.schemas.values(), *file.summary.channels.values())
                if file.summary
                else ()
            )
            for record in described or file.records():
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, DecodeError):
                    damage = damage or f"; {record}"
                # Whatever other images the file has: an export also has height maps.
                elif isinstance(record, Channel) and record.metadata.get(OURS) == CAMERA:
                    return record.topic, True
                elif isinstance(record, Channel) and (found := schemas.get(record.schema_id)):
                    topics |= (
                        {record.topic}
                        if (found.name, record.message_encoding) in DECODERS
                        else set()
                    )
            if file.cut_off:
                damage = damage or f"; {shown(path)} was cut off"
    if len(topics) == 1:
        return topics.pop(), False
    named = quoted(", ".join(sorted(topics)), _NAME_CHARS_MAX).strip("'")
    count = f"{len(topics)} image topics ({named})" if topics else "no image topics"
    expected = ", ".join(f"{schema} in {encoding}" for schema, encoding in DECODERS)
    raise ConfigError(
        f"{shown(paths[0])}: found {count}, expected one (supported: {expected}){damage}"
    )


def _about(payload: bytes) -> FrameAbout | str:
    """The content of a `FRAME` message, or why it is none."""
    if len(payload) > _ABOUT_BYTES_MAX:
        return (
            f"found {len(payload)} bytes on the channel `frame`, expected at most "
            f"{_ABOUT_BYTES_MAX}"
        )
    try:
        return msgspec.json.decode(payload, type=FrameAbout)
    except (ValueError, RecursionError) as error:
        return f"{shown(error)}, on the channel `frame`"


# Encoding to its number of channels and OpenCV's code for the conversion to BGR.
_ENCODINGS: Final[dict[str, tuple[int, int | None]]] = {
    "mono8": (1, None),
    "8UC1": (1, None),
    "bgr8": (3, None),
    "8UC3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
}


def _compressed(data: bytes) -> U8:
    # A camera's pixels as they are: a JPEG may ask to be turned.
    return decode_image(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def _raw(image: PixelRows) -> U8:
    if image.encoding not in _ENCODINGS:
        raise DecodeError(
            f"found the encoding {quoted(image.encoding)}, expected one of {', '.join(_ENCODINGS)}"
        )
    channels, to_bgr = _ENCODINGS[image.encoding]
    rows, cols, step = image.height_px, image.width_px, image.step_bytes
    if not (min(rows, cols) > 0 and max(rows, cols) <= SIDE_MAX_PX and rows * cols <= PIXELS_MAX):
        raise DecodeError(f"found {cols}x{rows} px, expected at most {SIDE_MAX_PX} px per side")
    if step < cols * channels or len(image.data) < rows * step:
        raise DecodeError(f"found {len(image.data)} bytes, expected {rows} rows of {step} bytes")
    pixels = np.frombuffer(image.data, np.uint8, rows * step).reshape(rows, step)[
        :, : cols * channels
    ]
    # A copy: the view is read-only and would keep the message in memory.
    if channels == 1:
        return pixels.copy()
    pixels = pixels.reshape(rows, cols, channels)
    return pixels.copy() if to_bgr is None else np.asarray(cv2.cvtColor(pixels, to_bgr), np.uint8)


def _foxglove_raw(payload: bytes) -> U8:
    message = RawImage.FromString(payload)
    return _raw(
        PixelRows(message.height, message.width, message.encoding, message.step, message.data)
    )


# (schema, encoding of messages) to a function from payload to pixels.
DECODERS: Final[dict[tuple[str, str], Callable[[bytes], U8]]] = {
    ("foxglove.CompressedImage", "protobuf"): lambda payload: _compressed(
        CompressedImage.FromString(payload).data
    ),
    ("foxglove.RawImage", "protobuf"): _foxglove_raw,
    ("sensor_msgs/msg/CompressedImage", "cdr"): lambda data: _compressed(
        ros_image.decode_compressed_image(data)
    ),
    ("sensor_msgs/msg/Image", "cdr"): lambda payload: _raw(ros_image.decode_image(payload)),
}


def image_of(schema: str, encoding: str, payload: bytes) -> U8:
    """The picture in a message, uint8 (H, W) grey or (H, W, 3) BGR. Raises DecodeError."""
    if (schema, encoding) not in DECODERS:
        raise DecodeError(
            f"found a {quoted(schema)} message encoded as {quoted(encoding)}, "
            "expected an image message"
        )
    try:
        return DECODERS[schema, encoding](payload)
    except ProtobufError as error:
        raise DecodeError(f"{schema}: {error}, expected an image") from None
