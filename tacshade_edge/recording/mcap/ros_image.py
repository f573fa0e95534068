"""Decode the images in ROS 2 bags: ``sensor_msgs/msg/Image`` and ``CompressedImage`` in CDR
(XCDR1).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from tacshade_edge.errors import DecodeError

_ENCAPSULATION_BYTES = 4


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
    cursor = _Cursor(payload)
    height_px, width_px = cursor.u32(), cursor.u32()
    encoding = cursor.text()
    cursor.skip(1)  # is_bigendian: these encodings have one byte per channel
    return PixelRows(height_px, width_px, encoding, cursor.u32(), cursor.octets())


def decode_compressed_image(payload: bytes) -> bytes:
    """Return the file (JPEG, PNG) in a ``sensor_msgs/msg/CompressedImage``. Raises DecodeError."""
    cursor = _Cursor(payload)
    cursor.text()
    return cursor.octets()


class _Cursor:
    """Reads the values after a ``std_msgs/Header``, each aligned to its own size, counted from the
    end of the encapsulation (DDSI-RTPS 10, XCDR1).
    """

    def __init__(self, payload: bytes) -> None:
        if len(payload) < _ENCAPSULATION_BYTES or payload[0] != 0 or payload[1] > 1:
            raise DecodeError(
                f"found {payload[:4].hex() or 'nothing'} at the start of a ROS 2 message, "
                "expected a CDR header"
            )
        self._u32 = struct.Struct("<I" if payload[1] == 1 else ">I")
        self._payload, self._at = (
            payload,
            _ENCAPSULATION_BYTES + 8,
        )  # the header's time, and then its frame's name
        self.text()

    def skip(self, count: int) -> None:
        self._at += count

    def u32(self) -> int:
        self._at += -self._at % 4
        try:
            (value,) = self._u32.unpack_from(self._payload, self._at)
        except struct.error:
            raise DecodeError(
                f"found an image cut short after {len(self._payload)} bytes, expected a whole image"
            ) from None
        self._at += 4
        return int(value)

    def octets(self) -> bytes:
        count = self.u32()
        found = self._payload[self._at : self._at + count]
        if len(found) < count:
            raise DecodeError(
                f"found an image cut short after {len(self._payload)} bytes, expected a whole image"
            )
        self._at += count
        return found

    def text(self) -> str:
        return self.octets().rstrip(b"\0").decode("utf-8", "replace")
