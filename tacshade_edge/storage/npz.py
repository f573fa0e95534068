"""Reads the arrays of an ``.npz`` file that somebody else wrote, within limits that hold whatever the file says."""

from __future__ import annotations

import io
import math
import os
import struct
import tokenize
import zipfile
import zlib
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from tacshade_edge.errors import DecodeError
from tacshade_edge.regular_files import read_regular

_MEMBERS_MAX: Final = 16
# numpy and zipfile raise these on damaged bytes (TypeError: a .npy; RuntimeError: a flag or method zipfile lacks).
_DAMAGE: Final = (
    *(LookupError, ValueError, TypeError, EOFError, RuntimeError, MemoryError, OverflowError, struct.error),
    *(tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)


def read_arrays(path: str | os.PathLike[str], bytes_max: int, *, kinds: str = "biuf") -> dict[str, npt.NDArray[Any]]:
    """Read every array by name, in the file's order.

    Parameters
    ----------
    path : path
    bytes_max : int
        Greatest size of the file, and of its unpacked content.
    kinds : str
        The accepted kinds of `numpy.dtype`.

    Raises
    ------
    OSError
        As `read_regular`.
    DecodeError
        The file is damaged, of another kind or too large when unpacked.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(read_regular(path, bytes_max))) as archive:
            entries = archive.infolist()
            if len(entries) > _MEMBERS_MAX or sum(entry.file_size for entry in entries) > bytes_max:
                raise ValueError("too many or too large arrays")
            return {entry.filename.removesuffix(".npy"): _array(_unpacked(archive, entry), kinds) for entry in entries}
    except _DAMAGE as error:
        raise DecodeError(f"no intact .npz file: {error}") from None


def _unpacked(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """A member, of which no more is inflated than its stated size. Raises one of `_DAMAGE`."""
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):  # zipfile inflates the others whole
        raise ValueError("another compression")
    with archive.open(entry) as member:
        return member.read(entry.file_size + 1)


def _array(data: bytes, kinds: str) -> npt.NDArray[Any]:
    """The array in a .npy, which must be as long as its header says. Raises one of `_DAMAGE`."""
    stream = io.BytesIO(data)
    if npy.read_magic(stream) != (1, 0):
        raise ValueError("another version of .npy")
    shape, fortran_order, dtype = npy.read_array_header_1_0(stream)
    values = data[stream.tell() :]
    if dtype.kind not in kinds or min(shape, default=0) < 0 or len(values) != dtype.itemsize * math.prod(shape):
        raise ValueError("not as long as its header says")
    return np.frombuffer(values, dtype).reshape(shape, order="F" if fortran_order else "C")
