"""How far the evidence of a touch goes while nothing touches, and the limits that say where a touch begins.

A network that does not know a skin finds no contact in deep presses, but its log odds of contact rise all the same. The
sensor's own untouched frames show from where on they mean something.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tacshade_edge.core.contact.gate import SURE_PART
from tacshade_edge.types import RestLimits, frozen

TAIL = 50
"""Most values that the tail's decay is taken from; of few values, it is taken from the upper half."""
LEAST_FRAMES = 8
"""Fewer frames show no tail: a rate of 1 in 10,000 would be a hundred times their spread away."""


@frozen
class Evidence:
    """What speaks for a touch in a frame: the greatest log odds of contact in the disc, and the changed part of the
    picture.
    """

    logit: float
    changed_part: float


def upper_bound(values: Sequence[float], rate: float) -> float:
    """A value that the next one exceeds with at most this probability (0 to 1), from at least two.

    Of n exchangeable values the next exceeds the (k + 1)-th greatest with probability (k + 1) / (n + 1): with 1 / rate
    values or more that is the answer, without an assumption. With fewer, the tail beyond it is taken to fall at least
    as fast as an exponential one. The k excesses then are independent and exponential (Rényi 1953), and the next one
    exceeds c times their mean with probability (1 + c / k)^-k, which allows for the few frames that showed the mean.
    """
    ordered = np.sort(np.asarray(values, np.float64))[::-1]
    n = len(ordered)
    if (sure := int(rate * (n + 1))) >= 1:
        return float(ordered[sure - 1])
    k = min(n // 2, TAIL)
    start = ordered[k]
    mean = float(ordered[:k].mean() - start)
    factor = k * (((k + 1) / ((n + 1) * rate)) ** (1 / k) - 1)
    return float(start + factor * mean)


def limits_of(rest: Sequence[Evidence], false_contacts: float) -> RestLimits | None:
    """The limits that evidence exceeds in at most this part of the frames without a touch; None if there are fewer than
    `LEAST_FRAMES`. Each kind of evidence is allowed half of it.
    """
    if len(rest) < LEAST_FRAMES:
        return None
    each = false_contacts / 2
    return RestLimits(
        frames=len(rest),
        false_contacts=false_contacts,
        logit=upper_bound([one.logit for one in rest], each),
        changed_part=max(upper_bound([one.changed_part for one in rest], each), SURE_PART),
    )


def exceeds(evidence: Evidence, limits: RestLimits) -> bool:
    """Whether a frame shows a touch."""
    return evidence.logit > limits.logit or evidence.changed_part > limits.changed_part
