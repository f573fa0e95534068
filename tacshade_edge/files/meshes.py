"""Triangles as STL, points and surfaces as binary PLY."""

from __future__ import annotations

import io
from codecs import BOM_UTF8
from pathlib import Path

import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.quoting import quoted, shown
from tacshade_edge.regular_files import read_regular
from tacshade_edge.types import F32, F64, U8, U16

MAX_TRIANGLES = 200_000
# A binary file: 80 bytes of any text, the number of triangles, then these.
_HEAD_BYTES, _TRIANGLE_BYTES = 84, 50
_LINE_BYTES = 256
# An ASCII triangle takes about 270 bytes, more with long numbers and deep indents.
_MAX_BYTES = MAX_TRIANGLES * 400
_CORNERS = 3
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> F64:
    """The corners of all triangles, float64 (N, 3, 3), finite, N from 1 to `MAX_TRIANGLES`.

    Raises DecodeError.
    """
    try:
        data = read_regular(path, _MAX_BYTES)
    except OSError as error:
        expected = f"expected an STL file of at most {MAX_TRIANGLES} triangles"
        raise DecodeError(f"{shown(path)}: {error.strerror or error}, {expected}") from None
    count = int.from_bytes(data[80:84], "little")
    # A binary file may begin with "solid" too, but its length gives it away.
    if len(data) >= _HEAD_BYTES and len(data) == _HEAD_BYTES + count * _TRIANGLE_BYTES:
        corners = np.frombuffer(data, _TRIANGLE, offset=_HEAD_BYTES)["corners"].astype(np.float64)
    elif (text := data.removeprefix(BOM_UTF8)).lstrip()[:5].lower() == b"solid":
        corners = _ascii(path, text)
    else:
        raise DecodeError(
            f"{path}: found {len(data)} bytes that are neither an ASCII nor a binary STL file"
        )
    if not 0 < len(corners) <= MAX_TRIANGLES:
        raise DecodeError(f"{path}: found {len(corners)} triangles, expected 1 to {MAX_TRIANGLES}")
    if not np.isfinite(corners).all():
        raise DecodeError(
            f"{path}: found a corner with numbers that are not finite, expected finite numbers"
        )
    return corners


def stl_bytes(triangles_mm: F64) -> bytes:
    """The binary STL file of triangles (N, 3, 3) in mm, counter-clockwise as seen from outside."""
    a, b, c = np.moveaxis(triangles_mm, 1, 0)
    normal = np.cross(b - a, c - a)
    rows = np.zeros(len(triangles_mm), _TRIANGLE)
    rows["normal"] = normal / np.maximum(
        np.linalg.norm(normal, axis=1, keepdims=True), np.finfo(float).tiny
    )
    rows["corners"] = triangles_mm
    return (
        b"binary STL, mm".ljust(_HEAD_BYTES - 4) + len(rows).to_bytes(4, "little") + rows.tobytes()
    )


def _ascii(path: Path, data: bytes) -> F64:
    corners: list[tuple[float, float, float]] = []
    in_facet = 0
    for number, raw in enumerate(io.BytesIO(data), start=1):
        line = raw[:_LINE_BYTES].decode("ascii", "replace")
        word, *rest = line.split() or [""]
        if word.lower() == "vertex":
            try:
                x, y, z = map(float, rest)
            except ValueError:
                raise DecodeError(
                    f"{path}:{number}: found {quoted(line.strip())}, "
                    "expected a line of the form vertex x y z"
                ) from None
            if len(corners) == _CORNERS * MAX_TRIANGLES:
                raise DecodeError(
                    f"{path}: found more than {MAX_TRIANGLES} triangles, expected at most "
                    f"{MAX_TRIANGLES}"
                )
            corners.append((x, y, z))
            in_facet += 1
        elif word.lower() == "endfacet":
            if in_facet != _CORNERS:
                raise DecodeError(
                    f"{path}:{number}: found a facet with {in_facet} corners, expected {_CORNERS}"
                )
            in_facet = 0
    if in_facet:
        raise DecodeError(
            f"{path}: found the end of the file within a facet, expected an endfacet line first"
        )
    return np.array(corners, dtype=np.float64).reshape(-1, 3, 3)


def ply(points_mm: F32 | F64, comment: str, labels: U16 | None = None) -> bytes:
    """A PLY file of points (N, 3) in mm: x, y, z as float and, with `labels` (N,),
    each one's number as ``object``.
    """
    return ply_head(len(points_mm), comment, labelled=labels is not None) + ply_rows(
        points_mm, labels
    )


def ply_head(count: int, comment: str, *, labelled: bool = False) -> bytes:
    """The header of a file of `count` points; `ply_rows` follow, in one part or several."""
    names = [f"float {axis}" for axis in "xyz"] + ["ushort object"] * labelled
    properties = "".join(f"property {name}\n" for name in names)
    begin = f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {count}\n"
    return f"{begin}{properties}end_header\n".encode()


def ply_rows(points_mm: F32 | F64, labels: U16 | None = None) -> bytes:
    """The bytes of a file's points, or of some of them."""
    made = np.empty(
        len(points_mm),
        [(axis, "<f4") for axis in "xyz"] + [("object", "<u2")] * (labels is not None),
    )
    for axis, values in zip("xyz", np.asarray(points_mm, np.float32).reshape(-1, 3).T, strict=True):
        made[axis] = values
    if labels is not None:
        made["object"] = labels
    return made.tobytes()


def surface_ply(points_mm: F32, height_mm: F32, colour_bgr: U8, comment: str) -> bytes:
    """A PLY file of the surface through a map's points (rows, cols, 3) in mm: two triangles for
    each four neighbours that have a height, (rows, cols), counter-clockwise from outside; each
    vertex has its height as ``quality`` and a colour (rows, cols, 3).
    """
    known = np.isfinite(height_mm) & np.isfinite(points_mm).all(axis=-1)
    number = np.cumsum(known).reshape(known.shape).astype(np.int32) - 1
    vertices = np.empty(
        np.count_nonzero(known),
        [(name, "<f4") for name in ("x", "y", "z", "quality")]
        + [(name, "u1") for name in ("blue", "green", "red")],
    )
    for at, name in enumerate("xyz"):
        vertices[name] = points_mm[known, at]
    vertices["quality"] = height_mm[known]
    for at, name in enumerate(("blue", "green", "red")):
        vertices[name] = colour_bgr[known, at]
    whole = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    corners = (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
    a, b, c, d = (each[whole] for each in corners)
    faces = np.empty(2 * len(a), [("corners", "u1"), ("vertices", "<i4", 3)])
    faces["corners"] = 3
    faces["vertices"] = np.concatenate((np.stack((a, b, c), 1), np.stack((b, d, c), 1)))
    kinds = {"<f4": "float", "|u1": "uchar"}
    assert vertices.dtype.names is not None
    properties = "".join(
        f"property {kinds[vertices.dtype[name].str]} {name}\n" for name in vertices.dtype.names
    )
    head = (
        f"ply\nformat binary_little_endian 1.0\ncomment {comment}\n"
        f"element vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    return head.encode() + vertices.tobytes() + faces.tobytes()
