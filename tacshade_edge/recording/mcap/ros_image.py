"""Decodes the images in ROS 2 bags with `rosbags`: ``sensor_msgs/msg/Image`` and
``CompressedImage`` in CDR.
"""

from __future__ import annotations

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


def decode_image(payload: bytes) -> PixelRows:
    """Decode a ``sensor_msgs/msg/Image``. Raises DecodeError."""
    image = _decoded(payload, "sensor_msgs/msg/Image")
    return PixelRows(image.height, image.width, image.encoding, image.step, image.data.tobytes())


def decode_compressed_image(payload: bytes) -> bytes:
    """Return the file (JPEG, PNG) in a ``sensor_msgs/msg/CompressedImage``. Raises DecodeError."""
    return bytes(_decoded(payload, "sensor_msgs/msg/CompressedImage").data)


def _decoded(payload: bytes, kind: str) -> Any:
    types = _types()
    from rosbags.serde import SerdeError

    try:
        return types.deserialize_cdr(payload, kind)
    except SerdeError as error:
        raise DecodeError(f"{kind}: {shown(error)} Expected a whole message") from None


@cache
def _types() -> Typestore:
    """ROS 2's own types, loaded with the first image: they take a third of a second.

    Raises ConfigError if the extra is missing.
    """
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        found = f"found no package {error.name}, which images of ROS 2 need"
        raise ConfigError(f"{found}; to install it: {how_to_install('mcap')}") from None
    # Not the types that a file describes, which may be damaged or say anything: images have been
    # the same in every ROS 2.
    return get_typestore(Stores.ROS2_FOXY)
