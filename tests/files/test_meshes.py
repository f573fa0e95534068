from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.errors import DecodeError
from tacshade_edge.files.meshes import ply, read_stl, stl_bytes
from tacshade_edge.types import F64

TWO = np.array(
    (((0, 0, 0), (1, 0, 0.5), (0, 1, 2)), ((1, 1, 1), (2, 2, 2.25), (3, -3, 3))), dtype=np.float64
)


def binary(triangles: F64, head: bytes = b"solid made by a printer") -> bytes:
    rows = b"".join(bytes(12) + t.astype("<f4").tobytes() + b"\0\0" for t in triangles)
    return head.ljust(80, b" ") + len(triangles).to_bytes(4, "little") + rows


def ascii_text(triangles: F64) -> str:
    facets = "".join(
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x} {y:e} {z}\n" for x, y, z in t)
        + " endloop\nendfacet\n"
        for t in triangles
    )
    return f"solid name\n{facets}endsolid name\n"


def test_both_kinds(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    for data in (
        binary(TWO),
        binary(TWO, b"exported"),
        ascii_text(TWO).encode(),
        ascii_text(TWO).upper().encode(),
    ):
        path.write_bytes(data)
        np.testing.assert_array_equal(read_stl(path), TWO)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "found 0 bytes that are neither an ASCII nor a binary STL file"),
        (b"PNG" * 90, "found 270 bytes that are neither an ASCII nor a binary STL file"),
        (binary(TWO)[:-1], "solid"),
        (
            binary(TWO, b"cut")[:-1],
            "found 183 bytes that are neither an ASCII nor a binary STL file",
        ),
        (binary(TWO[:0]), "found 0 triangles, expected 1 to 200000"),
        (b"solid\nendsolid\n", "found 0 triangles"),
        (
            ascii_text(TWO).replace("vertex 1", "vertex one", 1).encode(),
            ":5: found 'vertex one.*expected a line of the form vertex x y z",
        ),
        (
            ascii_text(TWO).replace("  vertex 0.0", " corner 0", 1).encode(),
            ":8: found a facet with 2 corners",
        ),
        (ascii_text(TWO)[:60].encode(), "found the end of the file within a facet|expected a line"),
        (binary(np.full_like(TWO, np.inf)), "a corner with numbers that are not finite"),
    ],
)
def test_what_is_none(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(data)
    if said == "solid":  # cut off, and it names itself as ascii
        said = "found 0 triangles"
    with pytest.raises(DecodeError, match=said) as refusal:
        read_stl(path)
    assert str(path) in str(refusal.value)
    with pytest.raises(DecodeError, match="expected an STL file"):
        read_stl(tmp_path / "none.stl")


def test_what_is_written_is_read_and_its_faces_point_outwards(tmp_path: Path) -> None:
    path = tmp_path / "a.stl"
    path.write_bytes(stl_bytes(TWO))
    np.testing.assert_array_equal(read_stl(path), TWO)
    normal = np.frombuffer(path.read_bytes(), "<f4", 3, offset=84)
    np.testing.assert_allclose(
        normal, np.array((-0.5, -2, 1)) / np.linalg.norm((-0.5, -2, 1)), rtol=1e-6
    )


def test_a_ply_says_how_many() -> None:
    data = ply(np.zeros((7, 3)), "millimetres, base frame")
    assert data.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert len(data.split(b"end_header\n", 1)[1]) == 12 * 7
