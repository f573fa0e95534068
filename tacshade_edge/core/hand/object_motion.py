"""How a held object has moved since it was grasped, from the skin that sticks to it.

All patches are taken to be of one object, and the fingers to stand still in the hand. While the same patches stick, the
motion is fitted anew to what has changed since that link's beginning, so that nothing adds up at rest. When a patch
joins, leaves or begins to slip, the motion so far is kept and the next link begins with the patches that stick then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from tacshade_edge.core.hand.link import (
    AT_REST,
    LEVER_MM,
    OBSERVED_SD_MM,
    SHEAR_SD_MM,
    SHEAR_SD_PART,
    UNKNOWN_SD_MM,
    Link,
    LinkMotion,
    begin,
    solve,
)
from tacshade_edge.core.hand.patch import Patch, Patches, stack
from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.types import F64, freeze

UNSEEN_MM_S: Final = 10.0
"""The deviation of an unobserved direction grows so fast, up to `UNKNOWN_SD_MM`, in what a link leaves to the next: by
29 degrees/s. Where one finger touches a frame before the others, the object has not turned far unseen."""
REST_SHARE: Final = 0.1
"""So much of the covariance of a link without motion is left to the next: both see the same error of the instant that
is between them, each with the other sign, and it is left only as far as they weigh it otherwise."""
RECENTRED_MM: Final = 0.1
"""The point whose translation is reported is put amid the patches that hold, as long as that changes it by less."""
GAIN_SD: Final = 0.2
"""Relative error of all fingers' shear together: skins of one make follow an object by the same part."""
FARTHEST_LINE_MM: Final = 200.0
"""A rotation about a line farther off is a translation to a hand."""
_SCALE = np.array([1.0] * 3 + [LEVER_MM] * 3)


@dataclass(frozen=True, slots=True)
class Unobserved:
    """A motion that the patches do not show: a rotation about a line, or a translation along it.

    Attributes
    ----------
    axis : 3 floats
        Unit vector.
    through_mm : 3 floats or None
        A point of the line; None: a translation.
    """

    axis: tuple[float, float, float]
    through_mm: tuple[float, float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class ObjectMotion:
    """A point p of the hand's frame that the object had when it was grasped is at R (p - about) + about + translation.

    Attributes
    ----------
    since_ns : int
        When it was grasped.
    about_mm : float64 (3,)
        A point amid the patches.
    translation_mm : float64 (3,)
        Of that point.
    rotation_rad : float64 (3,)
        Rotation vector of R.
    covariance : float64 (6, 6)
        Of translation in mm and a small rotation after R in rad.
    unobserved : tuple of Unobserved
        What is in the covariance with a large deviation, and 0 in the motion.
    """

    since_ns: int
    about_mm: F64
    translation_mm: F64
    rotation_rad: F64
    covariance: F64
    unobserved: tuple[Unobserved, ...]

    def __post_init__(self) -> None:
        freeze(self, "about_mm", "translation_mm", "rotation_rad", "covariance")

    def rigid(self) -> Rigid:
        """Of all points of the hand's frame."""
        rotation = turn(self.rotation_rad).rotation
        return Rigid(rotation, self.about_mm + self.translation_mm - rotation @ self.about_mm)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The chain up to a link, the link, and what was seen last."""

    since_ns: int
    about_mm: F64
    base: Rigid
    spread: F64
    """Covariance of the base: of a small motion after it, about the hand's origin, in mm and rad."""
    keys: tuple[str, ...]
    link: Link
    began_ns: int
    unobserved: tuple[Unobserved, ...]
    seen: Patches
    seen_ns: int
    motion: LinkMotion


class ObjectTracker:
    """Follows the object that a hand holds."""

    def __init__(self) -> None:
        self._state: _State | None = None

    def step(self, t_ns: int, patches: Mapping[str, Patch]) -> ObjectMotion | None:
        """Take all patches at a time, by a key that each keeps while it touches; None when nothing touches."""
        if not patches:
            self._state = None
            return None
        stick = {key: patch for key, patch in patches.items() if not patch.slips}
        state = self._state
        if state is None:
            state = _grasped(t_ns, stick)
        else:
            if stick.keys() != set(state.keys):
                both = [key for key in state.keys if key in stick]
                rows = [state.keys.index(key) for key in both]
                # What moved since the last instant shows in the patches that stuck all along.
                state = _next_link(state, tuple(both), _picked(state.seen, rows))
                state = _seen(state, t_ns, stick)
                state = _next_link(state, tuple(stick), stack(list(stick.values())))
            state = _seen(state, t_ns, stick)
        self._state = state
        return _reported(state)


def _grasped(t_ns: int, stick: Mapping[str, Patch]) -> _State:
    """Begin the first link."""
    link = begin(stack(list(stick.values())))
    begun = _State(
        *(t_ns, link.middle_mm, shift(0.0, 0.0, 0.0), np.zeros((6, 6)), tuple(stick), link, t_ns, ()),
        *(link.start, t_ns, AT_REST),
    )
    return replace(begun, unobserved=_unobserved(begun))


def _next_link(state: _State, keys: tuple[str, ...], start: Patches) -> _State:
    """Keep the motion so far, and begin another link where these patches are at the time of the last."""
    link = begin(start)
    base = state.motion.rigid(state.link.middle_mm) @ state.base
    unseen_mm = min(UNKNOWN_SD_MM, UNSEEN_MM_S * (state.seen_ns - state.began_ns) / 1e9)
    way = np.append(state.motion.translation_mm, LEVER_MM * turned_rad(state.motion.rotation))
    moved_sd_mm = SHEAR_SD_PART * float(np.linalg.norm(way))
    spread = _spread(state, unseen_mm, max(REST_SHARE, moved_sd_mm / (SHEAR_SD_MM + moved_sd_mm)))
    about_mm = state.about_mm
    if keys:
        amid_mm = base.inverse().apply(link.middle_mm)
        change_mm = (base.rotation - np.eye(3)) @ (amid_mm - about_mm)
        about_mm = amid_mm if np.linalg.norm(change_mm) < RECENTRED_MM else about_mm
    begun = _State(
        *(state.since_ns, about_mm, base, spread, keys, link, state.seen_ns, ()),
        *(start, state.seen_ns, AT_REST),
    )
    return replace(begun, unobserved=_unobserved(begun))


def _seen(state: _State, t_ns: int, stick: Mapping[str, Patch]) -> _State:
    """Fit the link's motion to its patches now."""
    now = stack([stick[key] for key in state.keys])
    return replace(state, seen=now, seen_ns=t_ns, motion=solve(state.link, now, state.motion))


def _spread(state: _State, unseen_mm: float, share: float) -> F64:
    """Covariance of the whole motion about the hand's origin, with a share of the link's own."""
    link, motion = state.link, state.motion
    blind = link.unobserved * (unseen_mm / _SCALE[:, None])
    to_origin = _moved_to(-(link.middle_mm + motion.translation_mm))
    moved = motion.rigid(link.middle_mm)
    carried = np.zeros((6, 6))
    carried[:3, :3] = carried[3:, 3:] = moved.rotation
    carried[:3, 3:] = -_moved_to(moved.translation_mm)[:3, 3:] @ moved.rotation
    return np.asarray(
        to_origin @ (share * motion.covariance + blind @ blind.T) @ to_origin.T + carried @ state.spread @ carried.T
    )


def _moved_to(place_mm: F64) -> F64:
    """What gives a small motion about the origin as one about another place: its translation is that of this place."""
    x, y, z = place_mm.tolist()
    change = np.eye(6)
    change[:3, 3:] = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
    return change


def _unobserved(state: _State) -> tuple[Unobserved, ...]:
    """What the link and those before it leave in the dark."""
    link = state.link
    change = _moved_to(link.middle_mm)
    before = change @ state.spread @ change.T * np.outer(_SCALE, _SCALE)
    values, directions = np.linalg.eigh(before + UNKNOWN_SD_MM**2 * (link.unobserved @ link.unobserved.T))
    return tuple(_line(directions[:, i], link.middle_mm) for i in np.flatnonzero(values > OBSERVED_SD_MM**2))


def _line(direction: F64, middle_mm: F64) -> Unobserved:
    """The line of a small motion about the middle: patches that stand still are on it, so it is hardly a screw."""
    translation_mm, rotation = direction[:3], direction[3:] / LEVER_MM
    size = float(np.linalg.norm(rotation))
    far_mm, along_mm = float(np.linalg.norm(translation_mm)), abs(float(translation_mm @ rotation))
    if far_mm > FARTHEST_LINE_MM * size or along_mm > LEVER_MM * size**2:
        x, y, z = (translation_mm / far_mm).tolist()
        return Unobserved((x, y, z), None)
    x, y, z = (rotation / size).tolist()
    a, b, c = (middle_mm + np.cross(rotation, translation_mm) / size**2).tolist()
    return Unobserved((x, y, z), (a, b, c))


def _picked(patches: Patches, rows: list[int]) -> Patches:
    return Patches(
        *(patches.place_mm[rows], patches.normal[rows], patches.axis[rows], patches.shear_mm[rows]),
        *(patches.depth_mm[rows], patches.twist_rad[rows]),
    )


def _reported(state: _State) -> ObjectMotion:
    whole = state.motion.rigid(state.link.middle_mm) @ state.base
    now_mm = whole.apply(state.about_mm)
    change = _moved_to(now_mm)
    translation_mm, rotation_rad = now_mm - state.about_mm, turned_rad(whole.rotation)
    gained = GAIN_SD * np.concatenate((translation_mm, rotation_rad))
    return ObjectMotion(
        *(state.since_ns, state.about_mm, translation_mm, rotation_rad),
        *(change @ _spread(state, UNKNOWN_SD_MM, 1.0) @ change.T + np.outer(gained, gained), state.unobserved),
    )
