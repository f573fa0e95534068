"""How every JSON payload is written."""

from __future__ import annotations

import msgspec
import numpy as np


def encode_json(value: object) -> bytes:
    """A JSON payload; a NaN and an infinity, which JSON does not have, become null."""
    return msgspec.json.encode(value, enc_hook=_plain)


def _plain(value: object) -> object:
    """A number of numpy's as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form here")
