"""Images in messages of Foxglove and ROS: their pixels, and the time at which they were taken."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final, NamedTuple, TypeVar

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError as ProtobufError

from tacshade_edge.errors import DecodeError
from tacshade_edge.files.image_bytes import PIXELS_MAX, SIDE_MAX_PX, decode_image
from tacshade_edge.quoting import quoted
from tacshade_edge.recording.mcap import ros_image
from tacshade_edge.recording.mcap.ros_image import PixelRows
from tacshade_edge.types import U8

T = TypeVar("T")


class _Encoding(NamedTuple):
    """How a pixel is stored, and OpenCV's code for the conversion to BGR."""

    channels: int
    to_bgr: int | None = None
    # Of two bytes, or with one colour for two pixels.
    bytes_each: int = 1
    columns: int = 1


_YUY2 = _Encoding(2, cv2.COLOR_YUV2BGR_YUY2, columns=2)
_UYVY = _Encoding(2, cv2.COLOR_YUV2BGR_UYVY, columns=2)
_ENCODINGS: Final[dict[str, _Encoding]] = {
    "mono8": _Encoding(1),
    "8UC1": _Encoding(1),
    "mono16": _Encoding(1, bytes_each=2),
    "bgr8": _Encoding(3),
    "8UC3": _Encoding(3),
    "rgb8": _Encoding(3, cv2.COLOR_RGB2BGR),
    "bgra8": _Encoding(4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Encoding(4, cv2.COLOR_RGBA2BGR),
    "yuv422_yuy2": _YUY2,
    "yuyv": _YUY2,
    "yuv422": _UYVY,
    "uyvy": _UYVY,
    "bayer_rggb8": _Encoding(1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": _Encoding(1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": _Encoding(1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": _Encoding(1, cv2.COLOR_BayerGRBG2BGR),
}


def _compressed(data: bytes) -> U8:
    # A camera's pixels as they are: a JPEG may ask to be turned.
    return decode_image(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def _raw(image: PixelRows) -> U8:
    if image.encoding not in _ENCODINGS:
        raise DecodeError(
            f"found the encoding {quoted(image.encoding)}, expected one of {', '.join(_ENCODINGS)}"
        )
    channels, to_bgr, bytes_each, columns = _ENCODINGS[image.encoding]
    rows, cols, step = image.height_px, image.width_px, image.step_bytes
    if not (min(rows, cols) > 0 and max(rows, cols) <= SIDE_MAX_PX and rows * cols <= PIXELS_MAX):
        raise DecodeError(f"found {cols}x{rows} px, expected at most {SIDE_MAX_PX} px per side")
    if cols % columns:
        raise DecodeError(f"found {cols} columns of {image.encoding}, expected an even number")
    row_bytes = cols * channels * bytes_each
    if step < row_bytes or len(image.data) < rows * step:
        raise DecodeError(f"found {len(image.data)} bytes, expected {rows} rows of {step} bytes")
    pixels = np.frombuffer(image.data, np.uint8, rows * step).reshape(rows, step)[:, :row_bytes]
    if bytes_each > 1:
        # The high byte, as of a file of 16 bits.
        return pixels[:, 0 if image.is_big_endian else 1 :: bytes_each].copy()
    if channels > 1:
        pixels = pixels.reshape(rows, cols, channels)
    # A copy: the view is read-only and would keep the message in memory.
    return pixels.copy() if to_bgr is None else np.asarray(cv2.cvtColor(pixels, to_bgr), np.uint8)


def _foxglove_raw(payload: bytes) -> U8:
    message = RawImage.FromString(payload)
    return _raw(
        PixelRows(message.height, message.width, message.encoding, message.step, message.data)
    )


def _stated_ns(kind: type[CompressedImage] | type[RawImage], payload: bytes) -> int:
    stamp = kind.FromString(payload).timestamp
    return int(stamp.seconds * 1_000_000_000 + stamp.nanos)


class _Kind(NamedTuple):
    """How messages of a kind become pixels, and Unix times in ns, 0 if they state none."""

    pixels: Callable[[bytes], U8]
    stamp_ns: Callable[[bytes], int]


_CDR, _ROS1 = ros_image.cdr_stamp_ns, ros_image.ros1_stamp_ns
# By schema and encoding of messages.
KINDS: Final[dict[tuple[str, str], _Kind]] = {
    ("foxglove.CompressedImage", "protobuf"): _Kind(
        lambda payload: _compressed(CompressedImage.FromString(payload).data),
        partial(_stated_ns, CompressedImage),
    ),
    ("foxglove.RawImage", "protobuf"): _Kind(_foxglove_raw, partial(_stated_ns, RawImage)),
    ("sensor_msgs/msg/CompressedImage", "cdr"): _Kind(
        lambda payload: _compressed(ros_image.decode_compressed_image(payload)), _CDR
    ),
    ("sensor_msgs/msg/Image", "cdr"): _Kind(
        lambda payload: _raw(ros_image.decode_image(payload)), _CDR
    ),
    ("sensor_msgs/CompressedImage", "ros1"): _Kind(
        lambda payload: _compressed(ros_image.decode_compressed_image(payload, is_ros1=True)), _ROS1
    ),
    ("sensor_msgs/Image", "ros1"): _Kind(
        lambda payload: _raw(ros_image.decode_image(payload, is_ros1=True)), _ROS1
    ),
}


def image_of(schema: str, encoding: str, payload: bytes) -> U8:
    """The picture in a message, uint8 (H, W) grey or (H, W, 3) BGR. Raises DecodeError."""
    return _read(schema, encoding, lambda kind: kind.pixels(payload))


def stamp_ns_of(schema: str, encoding: str, payload: bytes) -> int:
    """The Unix time in ns at which a message says that its picture was taken; 0 if it does not.

    Raises DecodeError.
    """
    return _read(schema, encoding, lambda kind: kind.stamp_ns(payload))


def _read(schema: str, encoding: str, read: Callable[[_Kind], T]) -> T:
    if (schema, encoding) not in KINDS:
        raise DecodeError(
            f"found a {quoted(schema)} message encoded as {quoted(encoding)}, "
            "expected an image message"
        )
    try:
        return read(KINDS[schema, encoding])
    except ProtobufError as error:
        raise DecodeError(f"{schema}: {error}, expected an image") from None
