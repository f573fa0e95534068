"""Binarise tactile images, Fig. 4(b), in uint8 and reused buffers."""

from __future__ import annotations

from typing import TypeVar

import cv2
import numpy as np

from tacshade_edge.types import F32, U8, Binarisation

A = TypeVar("A", U8, F32)

ADAPTIVE_PITCHES = 4
"""Side of the adaptive threshold's neighbourhood in marker pitches: wide enough to hold black and white everywhere,
narrow enough to follow vignetting."""

ADAPTIVE_FLOOR = 0.6
"""Part of the disc's mean grey below which nothing is white, however dark its surroundings."""

# The threshold is slightly above the mean, so that a uniform surface is black however the products round.
_MORE = np.float32(1 / 64)

BLOCK_PX = 4
"""Side of the blocks whose means form the local mean."""


def odd(size: float) -> int:
    """Round to the nearest odd whole number, at least 1, so that a box has a middle."""
    return max(2 * round((size - 1) / 2) + 1, 1)


class Binariser:
    """Binarises grey images of one disc.

    ``adaptive`` compares with the local mean inside the disc, so that uneven light does not matter: the mean over a box
    of `ADAPTIVE_PITCHES` of means of 4x4 px blocks wholly inside, interpolated linearly between the blocks' middles.
    ``global`` compares with the disc's mean, ``otsu`` with its best split.

    The adaptive threshold is Q8.0 and within 2 levels of its exact value: two halvings and the interpolation round.

    Parameters
    ----------
    mask : uint8 (H, W)
        1 inside the disc, 0 outside.
    method : str
    pitch_px : float
        Marker pitch.
    """

    def __init__(self, mask: U8, method: Binarisation, pitch_px: float) -> None:
        self._shape = mask.shape
        self._method = method
        self._inside = padded(mask, BLOCK_PX, 0)
        self._opaque: U8 = np.multiply(self._inside, 255, dtype=np.uint8)
        self._masked, self._white, self._threshold = (np.zeros_like(self._inside) for _ in range(3))
        self._box = (odd(ADAPTIVE_PITCHES * pitch_px / BLOCK_PX),) * 2
        # A block partly outside the disc would round to another mean.
        self._whole: U8 = np.where(_quarter(self._opaque) == 255, np.uint8(255), np.uint8(0))
        count = self._sums(self._whole) / np.float32(255)
        self._per_box: F32 = np.divide(np.float32(1), count, out=np.zeros_like(count), where=count > 0)
        self._blocks = cv2.countNonZero(self._whole)

    def __call__(self, grey: U8) -> U8:
        """Binarise an image of the mask's shape.

        Returns
        -------
        uint8 (H, W)
            1 where white, 0 outside the disc; the next call overwrites it.
        """
        rows, cols = self._shape
        cv2.bitwise_and(grey, self._opaque[:rows, :cols], dst=self._masked[:rows, :cols])
        if self._method == "adaptive":
            parts = cv2.bitwise_and(_quarter(self._masked), self._whole)
            local = self._sums(parts)
            local *= self._per_box
            local += _MORE
            least = ADAPTIVE_FLOOR * cv2.sumElems(parts)[0] / max(self._blocks, 1)
            # For a whole number grey, grey > t is grey > floor(t); no t comes near 256.
            whole = np.maximum(local, np.float32(least)).astype(np.uint8)
            cv2.resize(whole, self._masked.shape[::-1], dst=self._threshold, interpolation=cv2.INTER_LINEAR)
            cv2.compare(self._masked, self._threshold, cv2.CMP_GT, dst=self._white)
        else:
            cv2.threshold(self._masked, self._split(), 255, cv2.THRESH_BINARY, dst=self._white)
        cv2.bitwise_and(self._white, self._inside, dst=self._white)
        return self._white[:rows, :cols]

    def _sums(self, parts: U8) -> F32:
        return np.asarray(
            cv2.boxFilter(parts, cv2.CV_32F, self._box, normalize=False, borderType=cv2.BORDER_CONSTANT), np.float32
        )

    def _split(self) -> float:
        inside = self._masked[self._inside > 0].reshape(-1, 1)
        if not inside.size:
            return 255.0
        if self._method == "global":
            return float(inside.mean())
        return float(cv2.threshold(inside, 0, 1, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0])


def binarise(grey: U8, mask: U8, method: Binarisation, pitch_px: float) -> U8:
    """Binarise a single image; see `Binariser`."""
    return Binariser(mask, method, pitch_px)(grey)


def padded(image: U8, multiple: int, value: int) -> U8:
    """Pad an image with `value` below and on the right, so that its sides are multiples of `multiple`."""
    rows, cols = (-size % multiple for size in image.shape)
    if rows == cols == 0:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, rows, 0, cols, cv2.BORDER_CONSTANT, value=value), np.uint8)


def halved(image: A) -> A:
    """Means over 2x2 px, rounded half up for uint8; the sides must be even. OpenCV has a fast path for this."""
    half: A = cv2.resize(image, (image.shape[1] // 2, image.shape[0] // 2), interpolation=cv2.INTER_AREA)
    return half


def _quarter(image: U8) -> U8:
    return halved(halved(image))
