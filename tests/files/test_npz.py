from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.lib import format as npy

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files import npz
from tacshade_edge.files.npz import BYTES_MAX, Content

CONTENT = Content(
    {"version": 1},
    {"image": np.arange(12, dtype=np.uint8).reshape(3, 4), "h": np.eye(2, order="F")},
)


def read(path: Path, data: bytes) -> Content:
    path.write_bytes(data)
    return npz.read(str(path), "calibration", "somebody")


def packed(members: dict[str, bytes], compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def array(value: object) -> bytes:
    stream = io.BytesIO()
    np.save(stream, np.asarray(value), allow_pickle=True)
    return stream.getvalue()


def test_what_is_written_is_read(tmp_path: Path) -> None:
    content = read(tmp_path / "c.npz", CONTENT.packed())
    assert content.meta == CONTENT.meta
    assert list(content.arrays) == ["image", "h"]
    for name, value in content.arrays.items():
        np.testing.assert_array_equal(value, CONTENT.arrays[name])


def of_shape(shape: tuple[int, ...]) -> bytes:
    """An array whose header says so, with 12 values."""
    stream = io.BytesIO()
    npy.write_array_header_1_0(stream, {"descr": "|u1", "fortran_order": False, "shape": shape})
    return stream.getvalue() + bytes(12)


@pytest.mark.parametrize(
    "members",
    [
        pytest.param({"a.npy": of_shape((300_000, 400_000))}, id="a shape that is not there"),
        pytest.param({"a.npy": array([None])}, id="objects"),
        pytest.param({"a.npy": bytes(BYTES_MAX)}, id="a bomb"),
        pytest.param({f"{i}.npy": bytes(BYTES_MAX // 10) for i in range(11)}, id="a bomb of parts"),
        pytest.param({f"{i}.npy": b"" for i in range(300)}, id="many"),
    ],
)
def test_what_is_larger_than_it_can_be_is_not_unpacked(
    tmp_path: Path, members: dict[str, bytes]
) -> None:
    data = packed(
        {"meta.npy": array(np.zeros(2, np.uint8)), "crc32.npy": array(np.uint32(0)), **members}
    )
    tracemalloc.start()
    try:
        with pytest.raises(
            ConfigError,
            match=(
                r"c\.npz: the file is damaged or not a calibration; expected a file written by so"
            ),
        ):
            read(tmp_path / "c.npz", data)
        assert tracemalloc.get_traced_memory()[1] < 2 << 20
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", [zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_directory_that_understates_its_member_unpacks_no_more(
    tmp_path: Path, compression: int
) -> None:
    size = 4 << 20
    data = packed({"meta.npy": array(np.zeros(size, np.uint8))}, compression)
    assert len(data) < 1 << 17
    stated = struct.pack("<I", size + 128)
    assert data.count(stated) == 2
    data = data.replace(stated, struct.pack("<I", 4096))
    tracemalloc.start()
    try:
        with pytest.raises(ConfigError, match="damaged"):
            read(tmp_path / "c.npz", data)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def test_a_directory_of_many_entries_is_not_read(tmp_path: Path) -> None:
    entries = 30_000 * (struct.pack("<4s6H3I5H2I", b"PK\1\2", *[0] * 9, 1, *[0] * 6) + b"a")
    (tmp_path / "c.npz").write_bytes(
        entries + struct.pack("<4s4H2IH", b"PK\5\6", *[0] * 4, len(entries), 0, 0)
    )
    tracemalloc.start()
    try:
        with pytest.raises(DecodeError, match="too many arrays"):
            npz.read_arrays(tmp_path / "c.npz", BYTES_MAX)
        assert tracemalloc.get_traced_memory()[1] < 2 * len(entries)
    finally:
        tracemalloc.stop()


def test_of_two_arrays_of_one_name_none_is_read(tmp_path: Path) -> None:
    stream = io.BytesIO(CONTENT.packed())
    with pytest.warns(UserWarning, match="Duplicate"), zipfile.ZipFile(stream, "a") as archive:
        archive.writestr("h.npy", array(np.eye(2)))
    with pytest.raises(ConfigError, match="damaged"):
        read(tmp_path / "c.npz", stream.getvalue())
