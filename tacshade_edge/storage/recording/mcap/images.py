"""Decodes images in MCAP messages: our own, Foxglove's and ROS 2's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.message import DecodeError as ProtobufError

from tacshade_edge.core.image.image_bytes import PIXELS_MAX, SIDE_MAX_PX, decode_image
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import ros_image
from tacshade_edge.protocol.ros_image import PixelRows
from tacshade_edge.quoting import quoted
from tacshade_edge.types import U8

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
    return decode_image(data, cv2.IMREAD_ANYCOLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def _raw(image: PixelRows) -> U8:
    if image.encoding not in _ENCODINGS:
        raise DecodeError(f"found the encoding {quoted(image.encoding)}, expected one of {', '.join(_ENCODINGS)}")
    channels, to_bgr = _ENCODINGS[image.encoding]
    rows, cols, step = image.height_px, image.width_px, image.step_bytes
    if not (min(rows, cols) > 0 and max(rows, cols) <= SIDE_MAX_PX and rows * cols <= PIXELS_MAX):
        raise DecodeError(f"found {cols}x{rows} px, expected at most {SIDE_MAX_PX} px per side")
    if step < cols * channels or len(image.data) < rows * step:
        raise DecodeError(f"found {len(image.data)} bytes, expected {rows} rows of {step} bytes")
    pixels = np.frombuffer(image.data, np.uint8, rows * step).reshape(rows, step)[:, : cols * channels]
    if channels == 1:
        return pixels.copy()
    pixels = pixels.reshape(rows, cols, channels)
    return pixels.copy() if to_bgr is None else np.asarray(cv2.cvtColor(pixels, to_bgr), np.uint8)


def _foxglove_raw(payload: bytes) -> U8:
    message = RawImage.FromString(payload)
    return _raw(PixelRows(message.height, message.width, message.encoding, message.step, message.data))


# (schema, encoding of messages) to a function from payload to pixels.
DECODERS: Final[dict[tuple[str, str], Callable[[bytes], U8]]] = {
    ("foxglove.CompressedImage", "protobuf"): lambda payload: _compressed(CompressedImage.FromString(payload).data),
    ("foxglove.RawImage", "protobuf"): _foxglove_raw,
    ("sensor_msgs/msg/CompressedImage", "cdr"): lambda data: _compressed(ros_image.decode_compressed_image(data)),
    ("sensor_msgs/msg/Image", "cdr"): lambda payload: _raw(ros_image.decode_image(payload)),
}


def image_of(schema: str, encoding: str, payload: bytes) -> U8:
    """The picture in a message.

    Returns
    -------
    uint8 (H, W) grey or (H, W, 3) BGR

    Raises
    ------
    DecodeError
    """
    if (schema, encoding) not in DECODERS:
        raise DecodeError(f"found a {quoted(schema)} message encoded as {quoted(encoding)}, expected an image message")
    try:
        return DECODERS[schema, encoding](payload)
    except ProtobufError as error:
        raise DecodeError(f"{schema}: {error}, expected an image") from None
