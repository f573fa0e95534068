"""Encode JSON payloads."""

from __future__ import annotations

import msgspec
import numpy as np


def encode_json(value: object) -> bytes:
    """Encode a JSON payload; NaN and infinity, which JSON lacks, become null."""
    return msgspec.json.encode(value, enc_hook=_plain)


def _plain(value: object) -> object:
    """Convert a numpy number to a Python number."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form here")
