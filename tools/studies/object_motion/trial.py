"""A grasp over time: the fingers' reports, and the object's true motion."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tacshade_edge.core.hand.patch import Patch
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import F64


@dataclass(frozen=True, slots=True, eq=False)
class Moment:
    """The patches of a hand at one time, and the truth.

    Attributes
    ----------
    t_ns : int
    patches : mapping
        The patch of every contact, by a key that stays the same.
    moved : Rigid
        The object's true motion since the first moment, in the hand's frame.
    """

    t_ns: int
    patches: Mapping[str, Patch]
    moved: Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """A grasp over time.

    Attributes
    ----------
    object, skin, event : str
        The held object, the kind of errors or sensors, and the event.
    fingers : int
        Greatest number of fingers.
    points_mm : float64 (n, 3)
        Points of the object in the hand's frame at the first moment, its middle first; errors and jumps are measured
        at these points.
    moments : iterable of Moment
    """

    object: str
    skin: str
    event: str
    fingers: int
    points_mm: F64
    moments: Iterable[Moment]
