"""Answer which known object was touched, how probably, or that it is none of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.sensor.recognition.metric import Metric, coordinates
from tacshade_edge.types import F32, F64, KnownObject

UNKNOWN_PART = 0.05  # of the touches of known objects that may be called unknown


@dataclass(frozen=True, slots=True)
class Answer:
    """The name of the object, and the probability that it is right; None if the
    object is unknown.
    """

    name: str | None = None
    probability: float | None = None


UNKNOWN = Answer()


def scores(between: F32, taught: F64, counts: F64, seen: F64, touches: int = 1) -> F64:
    """Score means `seen` (N, d) of so many touches against means `taught` (K, d) of `counts` (K,)
    touches: (N, K).

    A score is the logarithm of how much likelier they show that object than any other.
    """
    counts = counts[:, None]
    # Where the object is expected after n touches: at their mean, drawn towards 0, the mean of all
    # objects, the more the fewer they were.
    own = taught * (between / (between + 1 / counts))
    # What is then left of the object's own variance, and the variance of the mean that is seen.
    variance = between / (between * counts + 1) + 1 / touches
    another = between + 1 / touches
    near = ((seen[:, None] - own) ** 2 / variance + np.log(variance)).sum(axis=-1)
    anywhere = (seen**2 / another + np.log(another)).sum(axis=-1)
    return np.asarray((anywhere[:, None] - near) / 2)


class Recogniser:
    """Answers for objects that were taught; at least one."""

    def __init__(self, metric: Metric, known: Sequence[KnownObject]) -> None:
        self._metric = metric
        self.names = tuple(each.name for each in known)
        places = [coordinates(metric, each.touches).astype(np.float64) for each in known]
        self._taught = np.stack([place.mean(axis=0) for place in places])
        self._counts = np.array([len(place) for place in places], float)
        self._expected = [self._scores_of(len(place), places) for place in places]

    def answer(self, descriptions: F32) -> Answer:
        """Answer for touches of one object, described by (n, D), n at least 1."""
        seen = coordinates(self._metric, descriptions).astype(np.float64).mean(axis=0)
        found = scores(
            self._metric.between, self._taught, self._counts, seen[None], len(descriptions)
        )[0]
        best = int(np.argmax(found))
        expected = self._expected[best]
        # Conformal: of a known object's touches, at most this part score so low with their own
        # object, whatever the scores' distribution.
        below = np.searchsorted(expected, found[best], side="right")
        if (1 + below) / (1 + len(expected)) <= UNKNOWN_PART:
            return UNKNOWN
        # Relative to the best, so that no exponential overflows. Any other object has the score 0.
        weights = np.exp(self._metric.trust * (found - found[best]))
        other = np.exp(-self._metric.trust * found[best])
        return Answer(self.names[best], float(1 / (weights.sum() + other)))

    def _scores_of(self, count: int, places: Sequence[F64]) -> F64:
        """Scores that touches have with their own object after `count` taught it, ascending: the
        shipped ones, and those of each taught touch with the others of its object.
        """
        shipped = self._metric.scores[min(count, len(self._metric.scores)) - 1]
        own = [_left_out(self._metric.between, each) for each in places if len(each) > 1]
        return np.sort(np.concatenate((shipped.astype(np.float64), *own)))


def _left_out(between: F32, places: F64) -> F64:
    """The score of each of an object's touches with the others."""
    count = len(places)
    others = (places.sum(axis=0) - places) / (count - 1)
    taught = np.full(count, count - 1.0)
    return np.diagonal(scores(between, others, taught, places)).copy()
