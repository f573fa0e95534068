"""An ``.npz`` file of canonical JSON and some arrays, with the CRC-32 of both."""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import shown
from tacshade_edge.storage.npz import read_arrays

BYTES_MAX: Final = 64 << 20
"""Greatest size of the file, and of its unpacked content; two images of 4096x4096 px take half."""


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """The content of such a file.

    Attributes
    ----------
    meta : mapping
        JSON values only.
    arrays : mapping of str to array
        The checksum depends on their order.
    """

    meta: Mapping[str, Any]
    arrays: Mapping[str, Any]

    @property
    def crc32(self) -> int:
        """The CRC-32 of `meta` and `arrays`."""
        return _crc32(_json(self.meta), self.arrays)

    def packed(self) -> bytes:
        """The file's bytes."""
        stream = io.BytesIO()
        meta = np.frombuffer(_json(self.meta), dtype=np.uint8)
        np.savez_compressed(stream, meta=meta, crc32=np.uint32(self.crc32), **self.arrays)
        return stream.getvalue()


def read(name: str, what: str, writer: str) -> tuple[Content, int]:
    """Read a file's content and its CRC-32.

    Parameters
    ----------
    name : str
    what, writer : str
        The kind of file and the program that writes it, for error messages.

    Raises
    ------
    ConfigError
        The file is absent, of another kind, or damaged.
    """
    try:
        # In the file's order; another version may have other arrays, which its checksum covers.
        arrays = read_arrays(name, BYTES_MAX)
        meta, crc = arrays.pop("meta").tobytes(), int(arrays.pop("crc32"))
    except OSError as error:
        raise ConfigError(
            f"{shown(name)}: cannot read the {what}: {error.strerror}; expected a file written by {writer}"
        ) from None
    except (DecodeError, KeyError, ValueError, TypeError):
        raise ConfigError(
            f"{shown(name)}: the file is damaged or not a {what}; expected a file written by {writer}"
        ) from None
    if _crc32(meta, arrays) != crc:
        raise ConfigError(
            f"{name}: the file is damaged: found checksum {_crc32(meta, arrays):08x}, expected the stored {crc:08x}"
        )
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
