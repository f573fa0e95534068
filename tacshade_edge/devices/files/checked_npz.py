"""An ``.npz`` of canonical JSON and some arrays, with the CRC-32 of both."""

from __future__ import annotations

import io
import json
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tacshade_edge.errors import ConfigError

# What numpy and zipfile raise on damaged bytes (TypeError: a .npy; RuntimeError: a flag or method zipfile lacks).
_DAMAGE = (
    KeyError,
    ValueError,
    TypeError,
    EOFError,
    RuntimeError,
    MemoryError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """What is in such a file.

    Attributes
    ----------
    meta : mapping
        Of what JSON knows.
    arrays : mapping of str to array
        Their order counts.
    """

    meta: Mapping[str, Any]
    arrays: Mapping[str, Any]

    @property
    def crc32(self) -> int:
        """CRC-32 of both."""
        return _crc32(_json(self.meta), self.arrays)

    def packed(self) -> bytes:
        """The bytes of the file."""
        stream = io.BytesIO()
        meta = np.frombuffer(_json(self.meta), dtype=np.uint8)
        np.savez_compressed(stream, meta=meta, crc32=np.uint32(self.crc32), **self.arrays)
        return stream.getvalue()


def read(name: str, what: str, writer: str) -> tuple[Content, int]:
    """Read a file and its CRC-32.

    Parameters
    ----------
    name : str
    what, writer : str
        What it should be, and what writes it, for the text of an error.

    Raises
    ------
    ConfigError
        Absent, something else, or damaged.
    """
    try:
        with open(name, "rb") as stream, np.load(stream, allow_pickle=False) as npz:
            meta = npz["meta"].tobytes()
            # In the file's order; another version has other arrays, and its checksum is of those.
            arrays = {key: npz[key] for key in npz.files if key not in ("meta", "crc32")}
            crc = int(npz["crc32"])
    except OSError as error:
        raise ConfigError(
            f"{name}: cannot read the {what}: {error.strerror or 'not an .npz file'}; "
            f"expected a file written by {writer}"
        ) from None
    except _DAMAGE:
        raise ConfigError(f"{name}: not a {what}, or damaged; expected a file written by {writer}") from None
    if _crc32(meta, arrays) != crc:
        raise ConfigError(f"{name}: damaged: its checksum is {_crc32(meta, arrays):08x}, {crc:08x} is stored in it")
    try:
        known = json.loads(meta)
    except ValueError:
        known = None
    if not isinstance(known, dict):
        raise ConfigError(f"{name}: not a {what}; expected a file written by {writer}")
    return Content(known, arrays), crc


def _json(meta: Mapping[str, Any]) -> bytes:
    return json.dumps(meta, sort_keys=True).encode()


def _crc32(meta: bytes, arrays: Mapping[str, Any]) -> int:
    crc = zlib.crc32(meta)
    for name in arrays:
        array = np.ascontiguousarray(arrays[name])
        crc = zlib.crc32(f"{name}{array.dtype.str}{array.shape}".encode(), crc)
        crc = zlib.crc32(array.tobytes(), crc)
    return crc
