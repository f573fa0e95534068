"""Decodes the images in bags of ROS 2 (CDR) and ROS 1 with `rosbags`: ``sensor_msgs/msg/Image`` and
``CompressedImage``.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import shown
from tacshade_edge.version import how_to_install

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore


@dataclass(frozen=True, slots=True)
class PixelRows:
    """An uncompressed image, row by row, each of `step_bytes` with its padding.

    `encoding` is ``mono8``, ``bgr8`` and the like, as both ROS 2 and Foxglove name them.
    """

    height_px: int
    width_px: int
    encoding: str
    step_bytes: int
    data: bytes
    is_big_endian: bool = False


def decode_image(payload: bytes, *, is_ros1: bool = False) -> PixelRows:
    """Decode a ``sensor_msgs/msg/Image``. Raises DecodeError."""
    image = _decoded(payload, "sensor_msgs/msg/Image", is_ros1=is_ros1)
    data, is_big = image.data.tobytes(), bool(image.is_bigendian)
    return PixelRows(image.height, image.width, image.encoding, image.step, data, is_big)


def decode_compressed_image(payload: bytes, *, is_ros1: bool = False) -> bytes:
    """Return the file (JPEG, PNG) in a ``sensor_msgs/msg/CompressedImage``. Raises DecodeError."""
    return bytes(_decoded(payload, "sensor_msgs/msg/CompressedImage", is_ros1=is_ros1).data)


# The header comes first in every image, so that its time needs no decoding of the pixels.
_STAMPS = {True: struct.Struct("<iI"), False: struct.Struct(">iI")}
_CDR_HEAD_BYTES, _ROS1_STAMP = 4, struct.Struct("<4xII")


def cdr_stamp_ns(payload: bytes) -> int:
    """``header.stamp`` of a ROS 2 image in ns. Raises DecodeError."""
    if len(payload) < _CDR_HEAD_BYTES + 8:
        raise DecodeError(f"found {len(payload)} bytes, expected a whole message")
    # The last bit of the second byte is the order of bytes.
    stamp = _STAMPS[bool(payload[1] & 1)]
    seconds, nanoseconds = stamp.unpack_from(payload, _CDR_HEAD_BYTES)
    return int(seconds * 1_000_000_000 + nanoseconds)


def ros1_stamp_ns(payload: bytes) -> int:
    """``header.stamp`` of a ROS 1 image in ns. Raises DecodeError."""
    if len(payload) < _ROS1_STAMP.size:
        raise DecodeError(f"found {len(payload)} bytes, expected a whole message")
    seconds, nanoseconds = _ROS1_STAMP.unpack_from(payload)
    return int(seconds * 1_000_000_000 + nanoseconds)


def _decoded(payload: bytes, kind: str, *, is_ros1: bool) -> Any:
    types = typestore(is_ros1=is_ros1)
    from rosbags.serde import SerdeError

    try:
        return (types.deserialize_ros1 if is_ros1 else types.deserialize_cdr)(payload, kind)
    except SerdeError as error:
        raise DecodeError(f"{kind}: {shown(error)} Expected a whole message") from None


@cache
def typestore(*, is_ros1: bool) -> Typestore:
    """ROS's own types, loaded with the first image: they take a third of a second.

    Raises ConfigError if the extra is missing.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        found = f"found no package {error.name}, which images of ROS need"
        raise ConfigError(f"{found}; to install it: {how_to_install('mcap')}") from None
    # Not the types that a file describes, which may be damaged or say anything: images have been
    # the same in every ROS 2.
    return get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_FOXY)
