"""How far the evidence of a touch goes while nothing touches, and so where a touch begins.

A network that does not know a skin finds no contact in deep presses, yet its heights rise, and the
picture changes in one place. The sensor's own untouched frames show from where on that counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tacshade_edge.sensor.contact.gate import SURE_PART
from tacshade_edge.types import F64, U8, RestLimits, frozen

TAIL = 50
"""Most values that the tail's decay is taken from;
of few values, it is taken from the upper half.
"""
LEAST_FRAMES = 8
"""Of fewer frames, the limit for a rate of 1 in 10,000 is a hundred times their spread."""
FALSE_CONTACTS = 1e-4
"""Part of the frames without a touch that is taken for one, if the user states no other."""
WAYS = 4  # in which a picture is moved by a pixel
KINDS = 3  # of evidence, each of which is allowed an equal part of the false contacts


@frozen
class Evidence:
    """What speaks for a touch in a frame: the height of the most pressed part of the disc as the
    network finds it, whether or not it calls that a contact; the greatest local change of white
    (`sensor.contact.motion`); the part of the pixels that changed.
    """

    height_mm: float
    local_change: float
    changed_part: float


def upper_bound(values: Sequence[float], rate: float) -> float:
    """A value that the next one exceeds with at most this probability (0 to 1), from at least two.

    Of n exchangeable values the next exceeds the (k + 1)-th greatest with probability (k + 1) /
    (n + 1): with 1 / rate values or more that is the answer, without an assumption. With fewer, the
    tail beyond it is taken to fall at least as fast as an exponential one. The k excesses then are
    independent and exponential (Rényi 1953), and the next one exceeds c times their mean with
    probability (1 + c / k)^-k, which allows for the few frames that showed the mean.
    """
    ordered: F64 = np.sort(np.asarray(values, np.float64))[::-1]
    n = len(ordered)
    sure = int(rate * (n + 1))
    if sure >= 1:
        return float(ordered[sure - 1])
    k = min(n // 2, TAIL)
    start = ordered[k]
    mean = float(ordered[:k].mean() - start)
    # (k + 1) / (n + 1) · (1 + c / k)^-k = rate, solved for c.
    factor = k * (((k + 1) / ((n + 1) * rate)) ** (1 / k) - 1)
    return float(start + factor * mean)


def limits_of(
    rest: Sequence[Evidence], moved: Sequence[Sequence[Evidence]], false_contacts: float
) -> RestLimits | None:
    """The limits that evidence exceeds in at most this part of the frames without a touch; None if
    there are fewer than `LEAST_FRAMES`. `moved` is the evidence of frames at rest in a picture that
    has moved by a pixel, for each direction: a camera that drifts so far is in normal use. Heights,
    which are never below 0, must at least double: on some sensors they hardly vary at rest.
    """
    if len(rest) < LEAST_FRAMES:
        return None
    # Any kind may call a touch (Bonferroni): together they call one as seldom as asked.
    each = false_contacts / KINDS

    def limit(of: Callable[[Evidence], float]) -> float:
        values = [of(one) for one in rest]
        usual = float(np.median(values))
        # How far a pixel moves the middle of the values: the few moved frames have no tail to show.
        ways = [float(np.median([of(one) for one in way])) for way in moved if way]
        return upper_bound(values, each) + max(max(ways, default=usual) - usual, 0.0)

    usual_mm = float(np.median([one.height_mm for one in rest]))
    return RestLimits(
        frames=len(rest),
        false_contacts=false_contacts,
        height_mm=max(limit(lambda one: one.height_mm), 2 * usual_mm),
        local_change=limit(lambda one: one.local_change),
        changed_part=max(limit(lambda one: one.changed_part), SURE_PART),
    )


def moved_by_a_pixel(image: U8, way: int) -> U8:
    """An image, uint8 (H, W) or (H, W, 3), moved down, up, right or left (0 to 3)."""
    step = 1 if way % 2 == 0 else -1
    axis = way // 2
    moved = np.roll(image, step, axis)
    edge = 0 if step > 0 else image.shape[axis] - 1
    at = [slice(None)] * image.ndim
    at[axis] = slice(edge, edge + 1)
    # `roll` brings in the edge of the far side; the picture's own one is repeated instead.
    moved[tuple(at)] = image[tuple(at)]
    return moved
