"""How far the evidence of a touch goes while nothing touches, and so where a touch begins.

A network that does not know a skin finds no contact in deep presses, yet its heights rise, and the
picture changes in one place. The sensor's own untouched frames show from where on that counts.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.core.contact.gate import SURE_PART
from tacshade_edge.types import F64, RestLimits, frozen

TAIL = 50
"""Most values that the tail's decay is taken from; of few values, it is taken from the upper half."""
LEAST_FRAMES = 8
"""Of fewer frames, the limit for a rate of 1 in 10,000 is a hundred times their spread."""
KINDS = 3  # of evidence, each of which is allowed an equal part of the false contacts


@frozen
class Evidence:
    """What speaks for a touch in a frame: the height of the most pressed part of the disc as the
    network finds it, whether or not it calls that a contact; the greatest local change of white
    (`core.contact.motion`); the part of the pixels that changed.
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
    factor = k * (((k + 1) / ((n + 1) * rate)) ** (1 / k) - 1)
    return float(start + factor * mean)


def limits_of(rest: Sequence[Evidence], false_contacts: float) -> RestLimits | None:
    """The limits that evidence exceeds in at most this part of the frames without a touch; None if
    there are fewer than `LEAST_FRAMES`. Heights, which are never below 0, must at least double: on
    some sensors they hardly vary at rest.
    """
    if len(rest) < LEAST_FRAMES:
        return None
    each = false_contacts / KINDS
    heights_mm = [one.height_mm for one in rest]
    return RestLimits(
        frames=len(rest),
        false_contacts=false_contacts,
        height_mm=max(upper_bound(heights_mm, each), 2 * float(np.median(heights_mm))),
        local_change=upper_bound([one.local_change for one in rest], each),
        changed_part=max(upper_bound([one.changed_part for one in rest], each), SURE_PART),
    )
