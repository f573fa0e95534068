"""Whether a frame's white changed in one place, as by a touch, or as a whole,
as by a tip that sways.

A soft tip in flight shifts and turns its whole pattern. To first order that adds the pattern's
gradients to the white, so one least-squares step says how much of a change it explains, and what
is left.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.sensor.geometry.disc_map import REACH
from tacshade_edge.types import F32, F64, Bool, frozen

BLUR_CELLS = 1.5
"""Deviation of the smoothing, of 112 cells: a quarter of a common pitch,
so that the pattern remains.
"""
AROUND_CELLS = 3.0
"""Deviation of the neighbourhood in which a local change is measured."""
COMMON = 2.0
"""A local change counts beyond this many times the RMS change of the whole disc: the greatest of a
noise that is the same everywhere is as large."""
_RIM_CELLS = 4  # are left out: the smoothing reaches beyond the disc there
_LEAST_GRADIENT = 1e-3  # RMS per radius below which a pattern shows no motion
MOVED_ERROR = 1e-4
"""How far off `WhiteChange.moved_radii` may be, in disc radii: float32 errs by less."""


@frozen
class LatticeMotion:
    """The part of the squared change that a shift and a turn of the whole pattern explain, 0 to 1,
    and how far they go at the rim, in disc radii.
    """

    explained: float
    moved_radii: float


class WhiteChange:
    """Measures the change of one sensor's white from the reference's, float32 (N, N), 0 to 1;
    `inside` is the disc, bool (N, N).
    """

    def __init__(self, reference: F32, inside: Bool) -> None:
        self._shape = reference.shape
        side = 2 * _RIM_CELLS + 1
        disc = cv2.erode(
            inside.astype(np.uint8),
            np.ones((side, side), np.uint8),
            borderType=cv2.BORDER_CONSTANT,
            borderValue=0,
        )
        self._at = np.flatnonzero(disc)
        self._reference = _smooth(reference)
        self._space = np.empty_like(self._reference)
        # Near the rim, less of the smoothing falls on the disc. Divided by that part, but not by
        # the smallest ones, or the rim's noise would be the greatest change.
        self._weight = np.maximum(_around(disc.astype(np.float32)), np.float32(0.2))
        cell_radii = 2 * REACH / len(reference)
        axis = (np.arange(len(reference)) + 0.5 - len(reference) / 2) * cell_radii
        x, y = np.meshgrid(axis, axis)
        slopes = np.gradient(self._reference, cell_radii)
        down, across = np.asarray(slopes[0]), np.asarray(slopes[1])
        # Light scales the white, or lifts it: everywhere alike, or more on one side.
        light = self._columns(self._reference, np.ones_like(x), x, y)
        self._light = _basis(light)[0]
        # To first order, a shift changes a picture by its slopes, a turn by x times the slope down
        # less y times that across.
        motion = self._columns(across, down, x * down - y * across)
        # What light can do is not a motion's: the two explain separate parts, whose squares add.
        motion -= self._light @ (self._light.T @ motion)
        least = _LEAST_GRADIENT * np.sqrt(len(self._at))
        self._motion, self._from_motion = _basis(motion, least)
        self._both = np.concatenate((self._light, self._motion), axis=1)
        moves = (self._from_motion @ self._motion.T).astype(np.float64)
        self._still = moves @ self._reference.take(self._at)
        maps = np.zeros((len(moves), reference.size))
        maps[:, self._at] = moves
        self._moves: F32 = np.stack([_smoothed_back(each.reshape(self._shape)) for each in maps])

    def moved_radii(self, white: F32) -> float:
        """`LatticeMotion.moved_radii` of a frame's white within `MOVED_ERROR`,
        much faster than `motion`.
        """
        # The change is linear in the white, and so is how far it goes: three sums of products.
        moved: list[float] = (self._moves @ white.ravel() - self._still).tolist()
        return math.hypot(moved[0], moved[1]) + abs(moved[2])

    def motion(self, white: F32) -> LatticeMotion:
        """The motion in a frame's white."""
        change = self._changed(white)
        light, seen = self._light.T @ change, self._motion.T @ change
        # Of the change that light leaves.
        total = float(change @ change - light @ light)
        shift_x, shift_y, turn = (self._from_motion @ seen).tolist()
        explained = float(seen @ seen) / total if total > 0 else 0.0
        return LatticeMotion(min(explained, 1.0), math.hypot(shift_x, shift_y) + abs(turn))

    def local(self, white: F32) -> float:
        """The greatest local change of a frame's white that neither light nor a motion explains,
        beyond what the whole disc shows, in shares of white.
        """
        if not len(self._at):
            return 0.0
        left = self._changed(white)
        left -= self._both @ (self._both.T @ left)
        # In place: `_changed` returns a copy.
        left *= left
        squares = np.zeros(self._shape, np.float32)
        squares.put(self._at, left)
        around = _around(squares) / self._weight
        return math.sqrt(around.take(self._at).max()) - COMMON * math.sqrt(left.mean())

    def _changed(self, white: F32) -> F32:
        change = _smooth(white, self._space)
        change -= self._reference
        return change.take(self._at)

    def _columns(self, *maps: npt.NDArray[Any]) -> F32:
        return np.stack([each.take(self._at) for each in maps], axis=1).astype(np.float32)


def _smooth(white: F32, space: F32 | None = None) -> F32:
    return np.asarray(cv2.GaussianBlur(white, (0, 0), BLUR_CELLS, dst=space), np.float32)


def _smoothed_back(values: F64) -> F32:
    """What gives with a picture, flattened, the same sum of products as `values` with its
    `_smooth`: float32 (N * N,).
    """
    # Where the picture ends, `_smooth` mirrors it about its last cell: what falls beyond the end is
    # added where the mirror shows it.
    reach = len(values) - 1
    wide = cv2.GaussianBlur(
        np.pad(values, reach), (0, 0), BLUR_CELLS, borderType=cv2.BORDER_CONSTANT
    )
    for _ in range(2):
        middle = wide[reach : reach + len(values)]
        middle[1:] += wide[:reach][::-1]
        middle[:-1] += wide[reach + len(values) :][::-1]
        wide = np.ascontiguousarray(middle.T)
    made: F32 = wide.astype(np.float32).ravel()
    return made


def _around(values: F32) -> F32:
    return np.asarray(cv2.GaussianBlur(values, (0, 0), AROUND_CELLS), np.float32)


def _basis(columns: F32, least: float = 1e-6) -> tuple[F32, F32]:
    """An orthonormal basis of the columns, without directions whose singular value is at most
    `least`, and what leads from its coordinates back to the columns' factors.
    """
    basis, sizes, back = np.linalg.svd(columns, full_matrices=False)
    kept = sizes > least
    return basis[:, kept], back[kept].T / sizes[kept]
