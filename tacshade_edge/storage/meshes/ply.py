"""Points as binary PLY."""

from __future__ import annotations

import numpy as np

from tacshade_edge.types import F32, F64, U16


def ply(points_mm: F32 | F64, comment: str, labels: U16 | None = None) -> bytes:
    """A PLY file of points in mm: x, y, z as float and, with `labels`, the number of the point's ``object``.

    Parameters
    ----------
    points_mm : float32 or float64 (N, 3)
    comment : str
        One line that names the frame of reference.
    labels : uint16 (N,), optional
    """
    return head(len(points_mm), comment, labelled=labels is not None) + rows(points_mm, labels)


def head(count: int, comment: str, *, labelled: bool = False) -> bytes:
    """The header of a file of `count` points; `rows` follow, in one part or several."""
    names = [f"float {axis}" for axis in "xyz"] + ["ushort object"] * labelled
    properties = "".join(f"property {name}\n" for name in names)
    begin = f"ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {count}\n"
    return f"{begin}{properties}end_header\n".encode()


def rows(points_mm: F32 | F64, labels: U16 | None = None) -> bytes:
    """The bytes of a file's points, or of some of them."""
    made = np.empty(len(points_mm), [(axis, "<f4") for axis in "xyz"] + [("object", "<u2")] * (labels is not None))
    for axis, values in zip("xyz", np.asarray(points_mm, np.float32).reshape(-1, 3).T, strict=True):
        made[axis] = values
    if labels is not None:
        made["object"] = labels
    return made.tobytes()
