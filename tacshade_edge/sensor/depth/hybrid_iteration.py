"""Eq. 11 in real float32 arithmetic: the result of the published 25 iterations,
computed only where they still matter.

Ref. [20] works on complex numbers, because p and q start as Fourier transforms. Each iteration
squares the slopes, up to 1e15 and more after about six. From there on, R and f' vanish beside g_hn
and ε, so an iteration subtracts g_hn / ε from Z: such a cell is settled. When every cell of the
disc is, the remaining iterations are one multiplication. Fixed point could not hold slopes from
1e-3 to 1e17 (docs/explanation/numerics.md).
"""

from __future__ import annotations

import cv2
import numpy as np

from tacshade_edge.types import F32, Bool

ITERATIONS = 25
EPS = 2.2e-16
# p and q are divided by this: squares of slopes up to 2^54 and the 1 beside them then fit float32.
_SCALE = np.float32(2.0**24)
_PER_SCALE = np.float32(2.0**-24)
# |p|² + |q|² (divided by _SCALE²) above which |f'| is below 1e-6 ε, unless p² and q² cancel.
_SETTLED = np.float32(2.0**24)
_GROWTH = np.float32(1 / EPS)
_HALF, _ONE, _TWO = np.float32(0.5), np.float32(1), np.float32(2)


class HybridIteration:
    """Eq. 11 on images of one shape: ε |Z| of a g_hn, float32 (rows, cols), 0 to 1, after the 3x3
    median of ref. [20], with the number of values that were not finite (0 instead). Scaled to 0 to
    1, the disc's heights are within 0.006 of the complex128 result, or within what that changes by
    if g_hn is rounded differently. Work arrays belong to the instance, and SciPy keeps the
    transform's plan.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        from scipy.fft import rfft2  # only `paper` needs it

        self._rfft2 = rfft2
        self._gradient = np.zeros((2, *shape), np.float32)  # along columns and rows
        self._z = np.zeros((2, *shape), np.float32)  # real and imaginary part
        self._slopes = np.zeros((2, 2, *shape), np.float32)  # p and q; real and imaginary parts
        self._mirrored_rows = -np.arange(shape[0]) % shape[0]

    def __call__(self, g_hn: F32, inside: Bool) -> tuple[F32, int]:
        """ε |Z| and the number of values repaired; cells outside the disc may differ
        from the published result.
        """
        if not g_hn.any():  # the iteration turns such an image into a constant, which is no height
            return np.zeros_like(g_hn), 0
        with np.errstate(all="ignore"):  # overflow is normal for this method; it is repaired below
            self._start(g_hn)
            self._iterate(g_hn, inside)
            self._z *= np.float32(EPS)
            real, imaginary = self._z
            magnitude = np.sqrt(real * real + imaginary * imaginary)
        good = np.isfinite(magnitude)
        repaired = int(good.size - np.count_nonzero(good))
        return np.asarray(cv2.medianBlur(np.where(good, magnitude, 0), 3), np.float32), repaired

    def _start(self, g_hn: F32) -> None:
        """Z = g_hn - R of p and q that are the Fourier transforms of the gradient.

        R has the symmetry of a real image's transform: half of it is enough.
        """
        _backward(g_hn, self._gradient)
        # Eq. 12 is of slopes p and q; ref. [20] takes their transforms and never inverts them: with
        # 25 iterations they still decide the result. In float64, which takes no longer and divides
        # the largest error by four.
        p, q = self._rfft2(self._gradient.astype(np.float64)).astype(np.complex64)
        real, imaginary = _norm2(p.real, p.imag, q.real, q.imag, _ONE)
        reflectance = np.stack(_inverse(real, imaginary)[:2])
        cols, half = g_hn.shape[1], reflectance.shape[2]
        rest = reflectance[:, self._mirrored_rows, cols - half : 0 : -1]
        self._z[:, :, :half] = -reflectance
        self._z[0, :, half:], self._z[1, :, half:] = -rest[0], rest[1]
        self._z[0] += g_hn

    def _iterate(self, g_hn: F32, inside: Bool) -> None:
        z, p_and_q = self._z.reshape(2, -1), self._slopes.reshape(4, -1)
        grey, within = g_hn.ravel(), inside.ravel()
        growth = grey * _GROWTH
        for n in range(ITERATIONS):
            _backward(self._z, self._slopes)
            self._slopes *= _PER_SCALE
            moving = np.einsum("ij,ij->j", p_and_q, p_and_q) < _SETTLED
            if not (moving & within).any():
                z[0] -= np.float32(ITERATIONS - n) * growth
                return
            cells = np.flatnonzero(moving)
            before = z.take(cells, axis=1)
            z[0] -= growth
            # Eq. 11.
            z[:, cells] = before - _step(p_and_q.take(cells, axis=1), grey.take(cells))


def _backward(z: F32, out: F32) -> None:
    """Backward differences of (..., rows, cols) along columns, then rows;
    the first column or row of `out` stays 0.
    """
    np.subtract(z[..., 1:], z[..., :-1], out=out[0, ..., 1:])
    np.subtract(z[..., 1:, :], z[..., :-1, :], out=out[1, ..., 1:, :])


def _step(p_and_q: F32, grey: F32) -> F32:
    """The quotient f / (f' + ε), real and imaginary (2, N), from scaled slopes (4, N)."""
    p, p_i, q, q_i = p_and_q
    n, n_i = _norm2(p, p_i, q, q_i, _PER_SCALE * _PER_SCALE)
    r, r_i, s, s_i = _inverse(n, n_i)
    # Eq. 12 for light from the camera: f = g_hn - R with R = (1 + p² + q²)^-½, and f' = (p + q) R³.
    f, f_i = grey - r * _PER_SCALE, -r_i * _PER_SCALE
    cube, cube_i = r * s - r_i * s_i, r * s_i + r_i * s
    sum_, sum_i = p + q, p_i + q_i
    # f' + ε times _SCALE, so that neither it nor its square leaves float32's range.
    slope = (sum_ * cube - sum_i * cube_i) * _PER_SCALE + np.float32(EPS) * _SCALE
    slope_i = (sum_ * cube_i + sum_i * cube) * _PER_SCALE
    size = (slope * slope + slope_i * slope_i) * _PER_SCALE
    return np.stack(((f * slope + f_i * slope_i) / size, (f_i * slope - f * slope_i) / size))


def _norm2(p: F32, p_i: F32, q: F32, q_i: F32, one: np.float32) -> tuple[F32, F32]:
    """p² + q² + 1."""
    # As a product, because p² - p_i² loses its digits where the two are near each other.
    return (p - p_i) * (p + p_i) + (q - q_i) * (q + q_i) + one, _TWO * (p * p_i + q * q_i)


def _inverse(a: F32, b: F32) -> tuple[F32, F32, F32, F32]:
    """1 / √(a + bi) and 1 / (a + bi), of the root with a positive real part."""
    size: F32 = np.sqrt(a * a + b * b)
    larger: F32 = np.sqrt((size + np.abs(a)) * _HALF)  # of the root's two parts: nothing cancels
    smaller: F32 = np.abs(b) / (larger + larger)
    swap: F32 = np.multiply(a >= 0, larger - smaller, dtype=np.float32)
    root, root_i = (smaller + swap) / size, np.copysign(larger - swap, -b) / size
    size *= size
    return root, root_i, a / size, -b / size
