"""One grasp over time: what the fingers report, and how the object truly moves."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tacshade_edge.core.hand.patch import Patch
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """What a hand knows at a time.

    Attributes
    ----------
    t_ns : int
    patches : mapping
        Of every contact, by a key that it keeps.
    moved : Rigid
        The object's true motion since the first moment, in the hand's frame.
    """

    t_ns: int
    patches: Mapping[str, Patch]
    moved: Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A grasp; whatever makes these is a source of the study.

    Attributes
    ----------
    object, skin, event : str
        What is held, the errors that are drawn or the sensors that see it, and what happens.
    fingers : int
        At the most.
    points_mm : float64 (n, 3)
        Points of the object in the hand's frame at the first moment, its middle first: errors and jumps are theirs.
    moments : iterable of Moment
    """

    object: str
    skin: str
    event: str
    fingers: int
    points_mm: F64
    moments: Iterable[Moment]
