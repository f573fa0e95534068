"""Estimate the motion of a held object since it was grasped, from the skin that sticks to it.

All patches are assumed to belong to one object, and the fingers to stand still in the hand. While the same patches
stick, each fit uses the change since that link's beginning, so that nothing accumulates at rest. When a patch joins,
leaves or begins to slip, the motion so far is kept, and the next link begins with the patches that then stick.
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
    Patch,
    Patches,
    begin,
    solve,
    stack,
)
from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.types import F64, frozen

UNSEEN_MM_S: Final = 10.0
"""Growth of the deviation of an unobserved direction, up to `UNKNOWN_SD_MM`, that a link passes to the next: 29
degrees/s. If one finger touches a frame before the others, the object has not turned far unseen."""
REST_SHARE: Final = 0.1
"""Part of its covariance that a link without motion passes to the next: both see the same error of the instant between
them with opposite signs, so only the difference of their weights remains."""
RECENTRED_MM: Final = 0.1
"""The reported translation is that of a point amid the holding patches, if the change of point changes it by less."""
GAIN_SD: Final = 0.2
"""Relative error common to all fingers' shear: skins of one make follow an object by the same part."""
FARTHEST_LINE_MM: Final = 200.0
"""A rotation about a line farther away counts as a translation."""
_SCALE = np.array([1.0] * 3 + [LEVER_MM] * 3)


@dataclass(frozen=True, slots=True)
class Unobserved:
    """A motion that the patches do not show: a rotation about a line through a point along a unit vector, or a
    translation (no point).
    """

    axis: tuple[float, float, float]
    through_mm: tuple[float, float, float] | None


@frozen
class ObjectMotion:
    """A point of the object at p in the hand's frame at the grasp, `since_ns`, is now at R (p - about) + about +
    translation, with R of a rotation vector; the covariance (6, 6) is of the translation in mm and a small rotation
    after R in rad. Unobserved motions have a large deviation there, and are 0 here.
    """

    since_ns: int
    about_mm: F64
    translation_mm: F64
    rotation_rad: F64
    covariance: F64
    unobserved: tuple[Unobserved, ...]

    def rigid(self) -> Rigid:
        """The motion as a transform of all points of the hand's frame."""
        rotation = turn(self.rotation_rad).rotation
        return Rigid(rotation, self.about_mm + self.translation_mm - rotation @ self.about_mm)


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The chain of motions up to a link, the link, and the last patches."""

    since_ns: int
    about_mm: F64
    base: Rigid
    spread: F64
    """Covariance of the base, of a small motion after it about the hand's origin, in mm and rad."""
    keys: tuple[str, ...]
    link: Link
    began_ns: int
    unobserved: tuple[Unobserved, ...]
    seen: Patches
    seen_ns: int
    motion: LinkMotion


class ObjectTracker:
    """Tracks the object that a hand holds."""

    def __init__(self) -> None:
        self._state: _State | None = None

    def step(self, t_ns: int, patches: Mapping[str, Patch]) -> ObjectMotion | None:
        """Take all patches at a time, by a key that each keeps while it touches; return None if nothing touches."""
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
                # The motion since the last instant shows in the patches that still stick.
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
    """Keep the motion so far, and begin another link at these patches."""
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
    """The matrix (6, 6) that converts a small motion about the origin to one about another place."""
    x, y, z = place_mm.tolist()
    change = np.eye(6)
    change[:3, 3:] = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
    return change


def _unobserved(state: _State) -> tuple[Unobserved, ...]:
    """The motions that the link and those before it do not show."""
    link = state.link
    change = _moved_to(link.middle_mm)
    before = change @ state.spread @ change.T * np.outer(_SCALE, _SCALE)
    values, directions = np.linalg.eigh(before + UNKNOWN_SD_MM**2 * (link.unobserved @ link.unobserved.T))
    return tuple(_line(directions[:, i], link.middle_mm) for i in np.flatnonzero(values > OBSERVED_SD_MM**2))


def _line(direction: F64, middle_mm: F64) -> Unobserved:
    """The line of a small motion about the middle: resting patches lie on it, so it is hardly a screw."""
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
