"""An ``.npz`` file of canonical JSON and some arrays, with the CRC-32 of both."""

from __future__ import annotations

import io
import json
import math
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular

BYTES_MAX: Final = 64 << 20
"""Greatest size of the file, and of its unpacked content; two images of 4096x4096 px take half."""
_MEMBERS_MAX: Final = 16

# numpy and zipfile raise these on damaged bytes (TypeError: a .npy; RuntimeError: a flag or method zipfile lacks).
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
        members = _members(read_regular(name, BYTES_MAX))
        # In the file's order; another version may have other arrays, which its checksum covers.
        arrays = {key: _array(data) for key, data in members.items()}
        meta, crc = arrays.pop("meta").tobytes(), int(arrays.pop("crc32"))
    except OSError as error:
        raise ConfigError(
            f"{shown(name)}: cannot read the {what}: {error.strerror}; expected a file written by {writer}"
        ) from None
    except _DAMAGE:
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


def _members(data: bytes) -> dict[str, bytes]:
    """The members of an .npz by name, if the archive's table states acceptable sizes. Raises one of `_DAMAGE`."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        if len(entries) > _MEMBERS_MAX or sum(entry.file_size for entry in entries) > BYTES_MAX:
            raise ValueError("too many or too large arrays")
        # zipfile never unpacks more than the stated size.
        return {entry.filename.removesuffix(".npy"): archive.read(entry) for entry in entries}


def _array(data: bytes) -> npt.NDArray[Any]:
    """The array of numbers in a .npy, which must be as long as its header says. Raises one of `_DAMAGE`."""
    stream = io.BytesIO(data)
    if npy.read_magic(stream) != (1, 0):
        raise ValueError("another version of .npy")
    shape, fortran_order, dtype = npy.read_array_header_1_0(stream)
    values = data[stream.tell() :]
    if dtype.kind not in "biuf" or len(values) != dtype.itemsize * math.prod(shape):
        raise ValueError("not as long as its header says")
    return np.frombuffer(values, dtype).reshape(shape, order="F" if fortran_order else "C")


def _json(meta: Mapping[str, Any]) -> bytes:
    return json.dumps(meta, sort_keys=True).encode()


def _crc32(meta: bytes, arrays: Mapping[str, Any]) -> int:
    crc = zlib.crc32(meta)
    for name in arrays:
        array = np.ascontiguousarray(arrays[name])
        crc = zlib.crc32(f"{name}{array.dtype.str}{array.shape}".encode(), crc)
        crc = zlib.crc32(array.tobytes(), crc)
    return crc
