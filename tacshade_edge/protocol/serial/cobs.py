"""Consistent overhead byte stuffing: encodes any bytes without a zero, so that a zero can end a frame.

Cheshire and Baker, IEEE/ACM Transactions on Networking 7 (1999). The caller adds and removes the zero itself.
"""

from __future__ import annotations

from tacshade_edge.errors import DecodeError

_BLOCK = 254  # bytes after a code of 255, which stands for no zero


def encode(data: bytes) -> bytes:
    """Encode `data` without a zero: one byte longer, plus one for every 254 bytes without a zero."""
    out = bytearray()
    runs = data.split(b"\0")
    for number, run in enumerate(runs, 1):
        at = 0
        while len(run) - at >= _BLOCK:
            out.append(255)
            out += run[at : at + _BLOCK]
            at += _BLOCK
        if at == 0 or at < len(run) or number < len(runs):  # a full block at the very end needs no further code
            out.append(len(run) - at + 1)
            out += run[at:]
    return bytes(out)


def decode(data: bytes) -> bytes:
    """Decode the output of `encode`.

    Raises
    ------
    DecodeError
        The data hold a zero, or a block is longer than the rest of the data.
    """
    out = bytearray()
    at, end = 0, len(data)
    if b"\0" in data:
        raise DecodeError("COBS: found a zero byte inside a frame, expected none")
    while at < end:
        code = data[at]
        if at + code > end:
            raise DecodeError(f"COBS: found {end - at - 1} bytes in the last block, expected {code - 1}")
        out += data[at + 1 : at + code]
        at += code
        if code != 255 and at < end:
            out.append(0)
    return bytes(out)
