"""Consistent overhead byte stuffing: any bytes without a zero, so that a zero can end a frame.

Cheshire and Baker, IEEE/ACM Transactions on Networking 7 (1999). The zero itself is the caller's.
"""

from __future__ import annotations

from tacshade_edge.errors import DecodeError

_BLOCK = 254  # bytes after a code of 255, which stands for no zero


def encode(data: bytes) -> bytes:
    """`data` without a zero: one byte longer, and one more for every 254 bytes without a zero."""
    out = bytearray()
    runs = data.split(b"\0")
    for number, run in enumerate(runs, 1):
        at = 0
        while len(run) - at >= _BLOCK:
            out.append(255)
            out += run[at : at + _BLOCK]
            at += _BLOCK
        if at == 0 or at < len(run) or number < len(runs):  # a full block at the very end says it all
            out.append(len(run) - at + 1)
            out += run[at:]
    return bytes(out)


def decode(data: bytes) -> bytes:
    """What `encode` was given.

    Raises
    ------
    DecodeError
        A zero, or a block that is longer than what is left.
    """
    out = bytearray()
    at, end = 0, len(data)
    if b"\0" in data:
        raise DecodeError("COBS: found a zero inside a frame")
    while at < end:
        code = data[at]
        if at + code > end:
            raise DecodeError(f"COBS: found {end - at - 1} bytes in the last block, expected {code - 1}")
        out += data[at + 1 : at + code]
        at += code
        if code != 255 and at < end:
            out.append(0)
    return bytes(out)
