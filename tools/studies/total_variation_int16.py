"""The iteration of `core.image.total_variation` in int16: half the memory to move, twice the pixels at a time.

The bits differ, the iteration does not: tests/tools/studies/test_total_variation_int16.py bounds its distance from
float64 after equally many.

Formats, in grey levels (an image of 0 to 1 has 255 of them), with f fraction bits (`fraction_bits`) and W = 255 weight,
which no p is longer than:

| what | format | at most, levels |
|---|---|---|
| the image, less mid-grey | int16 Q.f | 127.5 |
| p / τ = 4 p | int16 Q.f | 4 W |
| the divergence of that | int16 Q.f | 13.7 W |
| a part of ∇u | int16 Q.f | 255 + 6.7 W |
| (p - τ ∇u) / τ | int16 Q.f | 255 + 6.7 W |
| 4 W + ‖∇u‖, by which that is divided (and times 4 W) | float32, then int16 Q.f | 361 + 13.3 W |

f is the most with which the greatest fits: 5 bits for the paper's weight of 0.1. So nothing leaves int16 on its way,
whatever the image; its values beyond 0 to 1 count as 0 and 1. Sums and quotients are OpenCV's all the same, which
saturate where NumPy's would wrap.

The result is the image as it was given, plus the divergence: that sums up to 0 exactly, so the mean stays.

::

    .venv/bin/python -m tools.studies.total_variation_int16     # what each precision costs and how far off it is
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from tacshade_edge.core.image.total_variation import ENOUGH, ITERATIONS_MAX, chambolle
from tacshade_edge.studies.tables import markdown
from tacshade_edge.studies.tradeoff.grid import chambolle_float64
from tacshade_edge.types import F32

I16 = npt.NDArray[np.int16]

LEVELS = 255.0
GREATEST_LEVELS, GREATEST_LENGTHS = 362, 13.3
"""Greatest of the values above: so many levels, a little more for what is rounded, and so many W."""
_INVERSE_TAU = 4
_INT16_MAX = 2**15 - 1


def fraction_bits(weight: float) -> int:
    """f: bits after the point of everything, so many that nothing can leave int16.

    Raises
    ------
    ValueError
        Weight over 1: less than an eighth of a level would be left.
    """
    if weight > 1:
        raise ValueError(f"total variation in int16: found a weight of {weight}, expected at most 1")
    return math.floor(math.log2(_INT16_MAX / (GREATEST_LEVELS + GREATEST_LENGTHS * LEVELS * weight)))


def chambolle_int16(image: F32, weight: float, iterations: int = ITERATIONS_MAX) -> F32:
    """As `total_variation.chambolle`, of an image of 0 to 1.

    Parameters
    ----------
    image : float32 (rows, cols)
        Finite; below 0 and above 1 what is done is as for 0 and 1.
    weight : float
        Over 0, at most 1.
    iterations : int
        At most so many; fewer where one changes next to nothing.

    Returns
    -------
    float32 (rows, cols)

    Raises
    ------
    ValueError
        See `fraction_bits`.
    """
    one = 2 ** fraction_bits(weight)
    longest = round(_INVERSE_TAU * LEVELS * weight * one)
    # Neighbours by a shift, as in `total_variation`; of two dimensions, as OpenCV takes four numbers for a colour.
    cols, count = image.shape[1], image.size
    source = _quantised(image, one)
    u_and_below, p_down_and_above, p_right_and_left = (
        np.zeros((1, count + more), np.int16) for more in (cols, cols, 1)
    )
    u, u_below, u_right = (u_and_below[:, at : at + count] for at in (0, cols, 1))
    p_above, p_down = p_down_and_above[:, :count], p_down_and_above[:, cols:]
    p_left, p_right = p_right_and_left[:, :count], p_right_and_left[:, 1:]
    divergence, space, down, right, norm = (np.zeros((1, count), np.int16) for _ in range(5))
    down_float, right_float = (np.empty((1, count), np.float32) for _ in range(2))
    last_row, last_col = down[:, -cols:], right[:, cols - 1 :: cols]
    first = previous = 0.0
    for i in range(iterations):
        if i > 0:
            cv2.subtract(p_above, p_down, dst=divergence)
            cv2.subtract(p_left, p_right, dst=space)
            cv2.add(divergence, space, dst=divergence)
        np.right_shift(divergence, 2, out=space)
        cv2.add(source, space, dst=u)
        cv2.subtract(u_below, u, dst=down)
        cv2.subtract(u_right, u, dst=right)
        last_row.fill(0)
        last_col.fill(0)
        np.copyto(down_float, down)
        np.copyto(right_float, right)
        cv2.magnitude(down_float, right_float, down_float)
        down_float += longest + 0.5
        np.copyto(norm, down_float, casting="unsafe")  # rounds down
        # The cost of `total_variation`, in other units.
        length = cv2.sumElems(norm)[0] - count * longest
        cost = cv2.norm(divergence, cv2.NORM_L2SQR) + _INVERSE_TAU * longest * length
        if i == 0:
            first = cost
        elif abs(previous - cost) < ENOUGH * first:
            break
        previous = cost
        for p, step in ((p_down, down), (p_right, right)):
            cv2.subtract(p, step, dst=p)
            cv2.divide(p, norm, dst=p, scale=longest)
    change = divergence.astype(np.float32).reshape(image.shape)
    change *= np.float32(1 / (_INVERSE_TAU * LEVELS * one))
    change += image
    return change


def _quantised(image: F32, one: int) -> I16:
    """Round to whole multiples of 1 / `one` level, mid-grey at 0, in one row."""
    levels = (np.clip(image, 0, 1) - np.float32(0.5)) * np.float32(LEVELS * one)
    rounded: I16 = np.rint(levels).astype(np.int16).reshape(1, -1)
    return rounded


PRECISIONS: dict[str, Callable[[F32, float], F32]] = {
    "float64": chambolle_float64,
    "float32": chambolle,
    "int16": chambolle_int16,
}


def main() -> None:
    """Denoise a noisy bump of 640x480 in each precision, at the paper's weight."""
    rows, cols = np.mgrid[-1:1:480j, -4 / 3 : 4 / 3 : 640j]
    noise = np.random.default_rng(0).normal(0, 0.05, rows.shape)
    image = np.clip(0.5 + 0.3 * np.exp(-8 * (rows**2 + cols**2)) + noise, 0, 1).astype(np.float32)
    cv2.setNumThreads(1)
    exact, table = chambolle_float64(image, 0.1), []
    for name, denoise in PRECISIONS.items():
        taken_ms = []
        for _ in range(5):
            began_ns = time.perf_counter_ns()
            found = denoise(image, 0.1)
            taken_ms.append((time.perf_counter_ns() - began_ns) / 1e6)
        off = LEVELS * float(np.abs(found - exact).max())
        table.append([name, f"{np.median(taken_ms):.1f}", f"{off:.3f}"])
    print(markdown(["precision", "ms", "grey levels from float64, at most"], table))


if __name__ == "__main__":
    main()
