"""An ``.npz`` file of canonical JSON and some arrays with the CRC-32 of both, and the records in
it: dataclasses of numbers, texts and arrays, with the bounds of the numbers in their types. Reading
takes no more memory than `BYTES_MAX`.
"""

from __future__ import annotations

import io
import json
import math
import os
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, Final, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np
import numpy.typing as npt
from numpy.lib import format as npy

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.file_kinds import kind_at, npz_kind
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular

NUMBER_MAX: Final = 1e6
"""Greatest number in somebody else's array, far above any length in mm or pixels."""
T = TypeVar("T")
Array = npt.NDArray[Any]
BYTES_MAX: Final = 64 << 20
"""Greatest size of the file, and of its unpacked content; two images of 4096x4096 px take half."""
_MEMBERS_MAX: Final = 256
# Begins each entry of the directory, which zipfile reads whole.
_ENTRY: Final = b"PK\x01\x02"
_START: Final = b"PK\x03\x04"
# numpy and zipfile raise these on damaged bytes (TypeError: a .npy; RuntimeError:
# a flag or method zipfile lacks).
_DAMAGE: Final = (
    LookupError,
    ValueError,
    TypeError,
    EOFError,
    RuntimeError,
    MemoryError,
    OverflowError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True, slots=True, eq=False)
class Content:
    """The content of such a file: JSON values, and arrays, on whose order the checksum depends."""

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


def read(name: str, what: str, writer: str) -> Content:
    """Read a file; `what` and `writer` are the kind of file and its program, for messages.

    Raises ConfigError.
    """
    try:
        # In the file's order; another version may have other arrays, which its checksum covers.
        arrays = read_arrays(name, BYTES_MAX)
        meta, crc = arrays.pop("meta").tobytes(), int(arrays.pop("crc32"))
        values = json.loads(meta)
        if not isinstance(values, dict):
            raise ValueError("found other JSON than a record")
    except OSError as error:
        raise ConfigError(
            f"{shown(name)}: cannot read the {what}: {error.strerror}; "
            f"expected a file written by {writer}"
        ) from None
    except (DecodeError, KeyError, ValueError, TypeError, RecursionError):
        kind = kind_at(name)
        if kind and f"a {what}" not in kind:
            found = f"found {kind}; expected a {what} written by {writer}"
        else:
            found = f"the file is damaged or not a {what}; expected a file written by {writer}"
        raise ConfigError(f"{shown(name)}: {found}") from None
    if what and (other := npz_kind(arrays, meta)) not in ("", what):
        raise ConfigError(f"{name}: found a {other}; expected a {what} written by {writer}")
    if (checksum := _crc32(meta, arrays)) != crc:
        raise ConfigError(
            f"{name}: the file is damaged: found checksum {checksum:08x}, "
            f"expected the stored {crc:08x}"
        )
    return Content(values, arrays)


def is_read(data: bytes) -> bool:
    """Whether `read` takes a file of this size and content."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
    return max(len(data), unpacked) <= BYTES_MAX


def parts_of(record: Any, kept: tuple[str, ...] = ()) -> tuple[dict[str, Any], dict[str, Array]]:
    """A record's values and arrays by field, those of a dataclass in it as its own.

    A field with its default is left out unless it is in `kept`,
    so that a record without it keeps its checksum.
    """
    meta: dict[str, Any] = {}
    arrays: dict[str, Array] = {}
    for field, value in ((field, getattr(record, field.name)) for field in fields(record)):
        if isinstance(value, np.ndarray):
            arrays[field.name] = value
        elif is_dataclass(value):
            inner = parts_of(value)
            meta, arrays = meta | inner[0], arrays | inner[1]
        elif field.name in kept or value != (
            field.default if field.default_factory is MISSING else field.default_factory()
        ):
            meta[field.name] = dict(value) if isinstance(value, Mapping) else value
    return meta, arrays


def record_of(kind: type[T], values: Mapping[str, Any], *, strict: bool = True) -> T:
    """The record that `parts_of` took apart; with `strict`, other values are refused.

    Raises ValueError.
    """
    known: set[str] = set()
    nested = _nested(kind, values, known)
    if strict and (unknown := sorted(set(values) - known)):
        raise ValueError(f"Object contains unknown field `{unknown[0]}`")
    return msgspec.convert(nested, kind, dec_hook=_array)


def read_arrays(
    path: str | os.PathLike[str], bytes_max: int, *, kinds: str = "biuf"
) -> dict[str, Array]:
    """Every array of any ``.npz`` file in the file's order;
    `kinds` are the accepted kinds of `numpy.dtype`.

    Raises OSError, and DecodeError if the file is damaged, of another kind, or, packed or not,
    larger than `bytes_max`.
    """
    try:
        data = read_regular(path, bytes_max)
        if data.count(_ENTRY) > _MEMBERS_MAX:
            raise ValueError("too many arrays")
        # zipfile also finds an archive behind other bytes, such as one in a recording.
        if not data.startswith(_START):
            raise ValueError("File is not a zip file")
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            entries = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            # Two readers might disagree on which of them counts.
            if len(entries) < len(archive.infolist()):
                raise ValueError("two arrays of the same name")
            if sum(entry.file_size for entry in entries.values()) > bytes_max:
                raise ValueError("too large arrays")
            return {name: _npy(_unpacked(archive, entry), kinds) for name, entry in entries.items()}
    except _DAMAGE as error:
        raise DecodeError(f"no intact .npz file: {error}") from None


def numbers(arrays: Mapping[str, Array], key: str, dimensions: int, *, nan: bool = False) -> Array:
    """An array of numbers from -`NUMBER_MAX` to it, or NaN with `nan`. Raises DecodeError."""
    array = arrays[key].reshape(()) if dimensions == 0 and arrays[key].size == 1 else arrays[key]
    if array.dtype.kind not in "biuf" or array.ndim != dimensions:
        found = f"found {array.dtype} values of shape {array.shape}"
        raise DecodeError(f"{key}: {found}, expected numbers in {dimensions} dimensions")
    if not nan and np.isnan(array).any():
        raise DecodeError(f"{key}: found NaN, expected numbers")
    # fmin and fmax pass over NaN, which may be wanted.
    extremes = [float(each.reduce(array, axis=None)) for each in (np.fmin, np.fmax) if array.size]
    if wrong := [value for value in extremes if abs(value) > NUMBER_MAX]:
        raise DecodeError(
            f"{key}: found {wrong[0]:g}, expected numbers from -{NUMBER_MAX:g} to {NUMBER_MAX:g}"
        )
    return array


def _nested(kind: type, values: Mapping[str, Any], known: set[str]) -> dict[str, Any]:
    """The values by field of `kind`, those of a dataclass in it in a dict of their own."""
    made: dict[str, Any] = {}
    hints = get_type_hints(kind)
    for name in (field.name for field in fields(kind)):
        if name in values:
            made[name] = values[name]
            known.add(name)
        elif is_dataclass(hints[name]):
            made[name] = _nested(hints[name], values, known)
    return made


def _array(kind: type, value: object) -> object:
    """Accept an array of the type that `kind`, such as `F32`, states."""
    dtype = np.dtype(get_args(get_args(kind)[1])[0]) if get_args(kind) else None
    if dtype is None or not isinstance(value, np.ndarray) or value.dtype != dtype:
        raise ValueError(f"Expected an array of {dtype}")
    return value


def _json(meta: Mapping[str, Any]) -> bytes:
    # Sorted, because the checksum is of these bytes.
    return json.dumps(meta, sort_keys=True).encode()


def _crc32(meta: bytes, arrays: Mapping[str, Any]) -> int:
    crc = zlib.crc32(meta)
    for name in arrays:
        # The same values have the same checksum, in whatever order memory holds them.
        array = np.ascontiguousarray(arrays[name])
        crc = zlib.crc32(f"{name}{array.dtype.str}{array.shape}".encode(), crc)
        crc = zlib.crc32(array.tobytes(), crc)
    return crc


def _unpacked(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    """A member, of which no more is inflated than its stated size. Raises one of `_DAMAGE`."""
    # zipfile inflates the other methods whole, whatever size is asked for.
    if entry.compress_type not in (
        zipfile.ZIP_STORED,
        zipfile.ZIP_DEFLATED,
    ):
        raise ValueError("another compression")
    with archive.open(entry) as member:
        # A byte more than stated, if there is one, shows that the entry lies.
        return member.read(entry.file_size + 1)


def _npy(data: bytes, kinds: str) -> Array:
    """The array in a .npy, which must be as long as its header says. Raises one of `_DAMAGE`."""
    stream = io.BytesIO(data)
    if npy.read_magic(stream) != (1, 0):
        raise ValueError("another version of .npy")
    shape, fortran_order, dtype = npy.read_array_header_1_0(stream)
    values = data[stream.tell() :]
    # Objects are pickled, and to unpickle them is to run somebody's code.
    if dtype.kind not in kinds:
        raise ValueError(f"found an array of {dtype}")
    if min(shape, default=0) < 0 or len(values) != dtype.itemsize * math.prod(shape):
        raise ValueError("not as long as its header says")
    return np.frombuffer(values, dtype).reshape(shape, order="F" if fortran_order else "C")
