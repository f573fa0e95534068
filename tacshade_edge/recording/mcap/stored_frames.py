"""The frames of a recording in MCAP: our own, with times and poses,
or the images of Foxglove or ROS 2.
"""

from __future__ import annotations

import contextlib
import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Final

import msgspec
from mcap.records import Channel, Message, Schema
from msgspec import Meta

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.tables import NUMBER_MAX
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.recording.frame_table import ERROR_US_MAX, T_NS_MAX, UNIT_TOLERANCE, TableRow
from tacshade_edge.recording.mcap.image_messages import KINDS, image_of, stamp_ns_of
from tacshade_edge.recording.mcap.reader import McapFile
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
# Messages that wait for an earlier one which the file has later, and their size.
_AHEAD_MAX: Final = 64
_AHEAD_BYTES_MAX: Final = 64 << 20
# Other programs' images that are no pictures of their own.
_VIDEOS: Final = ("CompressedVideo", "FFMPEGPacket", "Packet")
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

    Raises ConfigError if it does not have exactly one readable topic of images, or the given one.
    """

    def __init__(self, paths: Sequence[Path], topic: str | None = None) -> None:
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
        self.topic, self._is_ours = _topic_of(self._paths or paths, topic)
        self._unusable = 0
        self._is_stamped: bool | None = None

    def __iter__(self) -> Iterator[tuple[TableRow, Picture, int]]:
        """Every frame's row, its picture, which raises DecodeError if it is unusable,
        and its time in ns; in the order of the times at which the pictures were taken, if the first
        one states it, otherwise of those at which they were recorded.
        """
        last_ns = -1
        self._unusable, self._is_stamped = 0, None
        # Numbered over all files, as are the frames.
        images = ((path, found) for path in self._paths for found in self._images_in(path))
        for count, path, found, taken_ns in self._in_order(enumerate(images)):
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
                wall_ns = _bounded(message.log_time) if self._is_ours else taken_ns
                row = self._row(count, message, about, taken_ns)
                # Equal times are many programs' way to have none; our own differ.
                if row.t_ns < last_ns + self._is_ours:
                    expected = f"expected a time after the previous frame's, {last_ns} ns"
                    raise DecodeError(f"found the time {row.t_ns} ns, {expected}")
            except DecodeError as error:
                yield TableRow(str(count), max(last_ns, 0), None), self._picture(where, error), 0
                if too_many:
                    return
                continue
            last_ns = row.t_ns
            yield row, self._picture(where, (schema, encoding, message.data)), wall_ns

    def _in_order(
        self, images: Iterable[tuple[int, tuple[Path, _Image | DecodeError]]]
    ) -> Iterator[tuple[int, Path, _Image | DecodeError, int]]:
        """Images with their times, in that order, as far as few enough lie between; ours as they
        come.
        """
        waiting: list[tuple[int, int, Path, _Image]] = []
        size = 0
        for count, (path, found) in images:
            if isinstance(found, DecodeError) or self._is_ours:
                yield count, path, found, 0
                continue
            try:
                taken_ns = self._taken_ns(found)
            except DecodeError as error:
                where = f"{shown(path)}: message {count} of {shown(self.topic)}: "
                yield count, path, DecodeError(f"{where}{error}"), 0
                continue
            heapq.heappush(waiting, (taken_ns, count, path, found))
            size += len(found[2].data)
            while len(waiting) > _AHEAD_MAX or size > _AHEAD_BYTES_MAX:
                first_ns, number, where_from, image = heapq.heappop(waiting)
                size -= len(image[2].data)
                yield number, where_from, image, first_ns
        while waiting:
            taken_ns, count, path, image = heapq.heappop(waiting)
            yield count, path, image, taken_ns

    def _taken_ns(self, image: _Image) -> int:
        """The time of a picture. Raises DecodeError."""
        schema, encoding, message, _ = image
        stamp_ns = (
            stamp_ns_of(schema, encoding, message.data) if self._is_stamped is not False else 0
        )
        # The first one says which clock: times of two would be in no order.
        if self._is_stamped is None:
            self._is_stamped = stamp_ns > 0
        taken_ns = stamp_ns if self._is_stamped else message.log_time
        if self._is_stamped and taken_ns <= 0:
            raise DecodeError("found no time in its header, expected one as in the first message")
        return _bounded(taken_ns)

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

    def _row(
        self, count: int, message: Message, about: FrameAbout | str | None, taken_ns: int
    ) -> TableRow:
        """The row of a message, from our `FRAME` message or else from the picture's time.

        Raises DecodeError.
        """
        if not self._is_ours:
            return TableRow(str(count), taken_ns, None)
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


def _bounded(t_ns: int) -> int:
    """A file's time, which has 64 bits. Raises DecodeError for one that ours do not hold."""
    if t_ns > T_NS_MAX:
        raise DecodeError(f"found the time {t_ns}, expected at most 2^62 ns")
    return t_ns


def _topic_of(paths: Sequence[Path], wanted: str | None) -> tuple[str, bool]:
    """The wanted topic of images, ours, or the only one there is, and whether it is ours.

    Raises ConfigError.
    """
    topics: set[str] = set()
    videos: set[str] = set()
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
                elif isinstance(record, Channel) and (found := schemas.get(record.schema_id)):
                    if record.metadata.get(OURS) == CAMERA and wanted in (None, record.topic):
                        return record.topic, True
                    if (found.name, record.message_encoding) in KINDS:
                        topics.add(record.topic)
                    elif found.name.endswith(_VIDEOS):
                        videos.add(found.name)
            if file.cut_off:
                damage = damage or f"; {shown(path)} was cut off"
    if wanted in topics or (wanted is None and len(topics) == 1):
        return wanted or topics.pop(), False
    if wanted is not None:
        named = shown(", ".join(sorted(topics)))
        raise ConfigError(f"--topic: found {shown(wanted)}, expected one of {named}{damage}")
    raise ConfigError(f"{shown(paths[0])}: {_not_one(topics, videos)}{damage}")


def _not_one(topics: set[str], videos: set[str]) -> str:
    """Why there is not one topic of images."""
    expected = ", ".join(f"{schema} in {encoding}" for schema, encoding in KINDS)
    if topics:
        named = quoted(", ".join(sorted(topics)), _NAME_CHARS_MAX).strip("'")
        return (
            f"found {len(topics)} image topics ({named}), expected one, chosen with --topic "
            f"(supported: {expected})"
        )
    video = (
        f"; it has video ({shown(', '.join(sorted(videos)))}), which image_transport's `republish` "
        "turns into images"
        if videos
        else ""
    )
    return f"found no image topics, expected one (supported: {expected}){video}"


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
