"""Fit the rigid motion of an object while the same patches of skin hold it,
by weighted least squares.

Skin that sticks moves with the object. Its finger sees two components of that motion as shear, at
right angles to the finger's axis z, and one as depth, along the patch's normal n. With d the motion
of the object's point at the patch,

    (1 - z zᵀ) d = shear - shear_0
    n · d = -(depth - depth_0)
    a · ω = twist - twist_0

where a = (z + n / (n · z)) / 2, since twist is the rotation, seen along z, of points in a plane of
normal n. Between two instants n is the mean of both, which is exact for a plane and for a ball on a
ball.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from tacshade_edge.rigid import Rigid, shift, turn, turned_rad
from tacshade_edge.types import F64, frozen

Triple = tuple[float, float, float]
LEVER_MM: Final = 20.0  # distance from the axis of the point whose travel measures a rotation
# The deviations of patches are those of reconstructed pictures of a simulated hand, not of drawn
# errors: skins that are dragged slide in part, and depth under drag is read up to 1 mm too great.
# Of a change of shear along each axis, and its increase per mm of motion.
SHEAR_SD_MM, SHEAR_SD_PART = 0.05, 0.2
# Of depth; grows over the first 1.5 mm.
DEPTH_SD_MM, DEPTH_SD_PART, DEPTH_SD_FAR_MM = 0.07, 0.4, 1.5
TWIST_SD_RAD: Final = np.radians(4.0)
OBSERVED_SD_MM: Final = 0.8
"""A direction is unobserved if its standard deviation would exceed this after each patch moved
by `NOMINAL_MM`.
"""
NOMINAL_MM: Final = 2.0
UNKNOWN_SD_MM: Final = 50.0  # standard deviation reported for unobserved directions
# The square of the last step over the lever is left as error.
_STEPS, _CONVERGED_MM = 5, 0.02
_STEEPEST = 0.2  # n · z of a contact so far off the tip that no camera sees it
_EYE = np.eye(3)


@dataclass(frozen=True, slots=True)
class Patch:
    """One contact of one finger; vectors along the hand's axes: mean place, unit normal into the
    object, the finger's z axis, mean shear at right angles to it, greatest h; twist about it, None
    if the contact is too small.
    """

    place_mm: Triple
    normal: Triple
    axis: Triple
    shear_mm: Triple
    depth_mm: float
    twist_deg: float | None
    slips: bool = False


class _Patches:
    """Several patches as arrays, one row each; an unknown twist is NaN."""

    def __init__(self, patches: Iterable[Patch]) -> None:
        rows = np.array(
            [
                (*p.place_mm, *p.normal, *p.axis, *p.shear_mm, p.depth_mm, p.twist_deg)
                for p in patches
            ],
            np.float64,
        ).reshape(-1, 14)
        self.place_mm, self.normal, self.axis, self.shear_mm = (
            rows[:, :3],
            rows[:, 3:6],
            rows[:, 6:9],
            rows[:, 9:12],
        )
        self.depth_mm, self.twist_rad = rows[:, 12], np.radians(rows[:, 13])


@dataclass(frozen=True, slots=True, eq=False)
class _Link:
    """The beginning of a motion: its patches, their mean place, and orthonormal directions (6, k),
    (6, 6 - k) of a small motion about it: three components of translation, three of rotation times
    `LEVER_MM`.
    """

    start: _Patches
    middle_mm: F64
    observed: F64
    unobserved: F64


@dataclass(frozen=True, slots=True, eq=False)
class _Motion:
    """The motion since a link's beginning, with the translation of its middle and the covariance
    (6, 6), mm and rad, of a small motion after it about the moved middle, without unobserved
    directions.
    """

    rotation: F64 = field(default_factory=lambda: np.eye(3))
    translation_mm: F64 = field(default_factory=lambda: np.zeros(3))
    covariance: F64 = field(default_factory=lambda: np.zeros((6, 6)))

    def rigid(self, middle_mm: F64) -> Rigid:
        """The motion as a transform of all points of the hand's frame."""
        return Rigid(self.rotation, middle_mm + self.translation_mm - self.rotation @ middle_mm)


def _begun(start: _Patches) -> _Link:
    """Begin a motion at these patches, and find the directions that they will show."""
    count = len(start.depth_mm)
    middle_mm = start.place_mm.mean(axis=0) if count else np.zeros(3)
    weights = _weights(start, start.normal, np.full(count, NOMINAL_MM))
    rows = _jacobian(start.place_mm - middle_mm)
    information = np.tensordot(rows, weights @ rows, ((0, 1), (0, 1)))
    axes, known = _twist_axes(start, start.normal), np.isfinite(start.twist_rad)
    information[3:, 3:] += axes[known].T @ axes[known]
    values, directions = np.linalg.eigh(information)
    seen = values > OBSERVED_SD_MM**-2
    return _Link(start, middle_mm, directions[:, seen], directions[:, ~seen])


def _solved(link: _Link, now: _Patches, guess: _Motion) -> _Motion:
    """Fit the motion to the same patches now, in the same order,
    by Gauss-Newton on SE(3) from a first guess.
    """
    directions = link.observed
    if not directions.shape[1]:
        return guess
    start = link.start
    shear_mm, sunk_mm = now.shear_mm - start.shear_mm, now.depth_mm - start.depth_mm
    normal = 0.5 * (now.normal + start.normal)
    # Depth shows motion along the normal, shear what is across the axis: the rest follows.
    steep = np.maximum((normal * now.axis).sum(axis=1), _STEEPEST)
    along_mm = -(sunk_mm + (normal * shear_mm).sum(axis=1)) / steep
    moved_mm = shear_mm + along_mm[:, None] * now.axis
    # Place at the beginning of the material that touches now,
    # because a rolling contact moves over the object.
    was_mm = now.place_mm - moved_mm - link.middle_mm
    weights = _weights(now, normal, np.sqrt((moved_mm**2).sum(axis=1)))
    twisted_rad = now.twist_rad - start.twist_rad
    known = np.isfinite(twisted_rad)
    axes, twisted_rad = _twist_axes(now, normal)[known], twisted_rad[known] / TWIST_SD_RAD
    twist_rows = axes @ directions[3:]
    rotation, translation_mm = guess.rotation, guess.translation_mm
    damping = UNKNOWN_SD_MM**-2 * np.eye(directions.shape[1])
    for _ in range(_STEPS):
        is_mm = was_mm @ rotation.T
        rest_mm = moved_mm - (is_mm + translation_mm - was_mm)
        rows = _jacobian(is_mm) @ directions
        weighted = weights @ rows
        # The rotation vector times its sine over its length: a link's motion is small.
        m = rotation - rotation.T
        twist_rest = twisted_rad - axes @ (0.5 * np.array((m[2, 1], m[0, 2], m[1, 0]))) * LEVER_MM
        # The damping keeps a direction defined that a contact no longer shows after turning over.
        information = (
            np.tensordot(rows, weighted, ((0, 1), (0, 1))) + twist_rows.T @ twist_rows + damping
        )
        gradient = np.tensordot(rest_mm, weighted, 2) + twist_rest @ twist_rows
        covariance = np.linalg.inv(information)
        step = directions @ (covariance @ gradient)
        rotation = turn(step[3:] / LEVER_MM).rotation @ rotation
        translation_mm = translation_mm + step[:3]
        if step @ step < _CONVERGED_MM**2:
            break
    scaled = directions.copy()
    scaled[3:] /= LEVER_MM
    return _Motion(rotation, translation_mm, scaled @ covariance @ scaled.T)


def _weights(patches: _Patches, normal: F64, far_mm: F64) -> F64:
    """Information (n, 3, 3) on the motion at each patch, given how far it moved."""
    z = patches.axis
    of_shear = (SHEAR_SD_MM + SHEAR_SD_PART * far_mm) ** -2
    of_depth = (DEPTH_SD_MM + DEPTH_SD_PART * np.minimum(far_mm, DEPTH_SD_FAR_MM)) ** -2
    return np.asarray(
        of_shear[:, None, None] * (_EYE - z[:, :, None] * z[:, None, :])
        + (of_depth[:, None] * normal)[:, :, None] * normal[:, None, :]
    )


def _twist_axes(patches: _Patches, normal: F64) -> F64:
    """The change of each twist, in its standard deviations, with a rotation times the lever:
    (n, 3).
    """
    steep = np.maximum((normal * patches.axis).sum(axis=1), _STEEPEST)
    return np.asarray((patches.axis + normal / steep[:, None]) * (0.5 / (LEVER_MM * TWIST_SD_RAD)))


def _jacobian(arms_mm: F64) -> F64:
    """Jacobian of points, given relative to the middle, by a small motion about the middle:
    (n, 3, 6).
    """
    rows = np.zeros((len(arms_mm), 3, 6))
    rows[:, 0, 0] = rows[:, 1, 1] = rows[:, 2, 2] = 1.0
    x, y, z = (arms_mm / LEVER_MM).T
    rows[:, 0, 4], rows[:, 0, 5] = z, -y
    rows[:, 1, 3], rows[:, 1, 5] = -z, x
    rows[:, 2, 3], rows[:, 2, 4] = y, -x
    return rows


# Growth of the deviation of an unobserved direction that a link passes to the next.
UNSEEN_MM_S: Final = 10.0
REST_SHARE: Final = 0.1
"""Part of its covariance that a link without motion passes to the next: both see the error of the
instant between them with opposite signs, so only the difference of their weights remains.
"""
# The reported point is amid the holding patches, if that changes its motion by less.
RECENTRED_MM: Final = 0.1
# Relative error common to all fingers' shear: skins of one make follow an object by the same part.
GAIN_SD: Final = 0.2
FARTHEST_LINE_MM: Final = 200.0  # a rotation about a line farther away counts as a translation
_SCALE = np.array([1.0] * 3 + [LEVER_MM] * 3)


@dataclass(frozen=True, slots=True)
class Unobserved:
    """A motion that the patches do not show: a rotation about a line through a point along a unit
    vector, or a translation (no point).
    """

    axis: Triple
    through_mm: Triple | None


@frozen
class ObjectMotion:
    """A point of the object at p in the hand's frame at the grasp is now at R (p - about) + about +
    translation, with R of a rotation vector; the covariance (6, 6) is of the translation and a
    small rotation after R. Unobserved motions have a large deviation there, and are 0 here.
    """

    since_ns: int
    about_mm: F64
    translation_mm: F64
    rotation_rad: F64
    covariance: F64
    unobserved: tuple[Unobserved, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    """The chain of motions up to a link, the link, and the last patches."""

    since_ns: int
    about_mm: F64
    base: Rigid
    # Covariance of the base, of a small motion after it about the hand's origin, in mm and rad.
    spread: F64
    link: _Link
    began_ns: int
    unobserved: tuple[Unobserved, ...]
    seen: Mapping[str, Patch]
    seen_ns: int
    motion: _Motion

    def whole(self) -> Rigid:
        """The motion since the grasp."""
        return self.motion.rigid(self.link.middle_mm) @ self.base


class ObjectTracker:
    """Tracks the object that a hand holds, from the skin that sticks to it.

    While the same patches stick, each fit uses the change since that link's beginning, so that
    nothing accumulates at rest. When a patch joins, leaves or begins to slip, the motion so far is
    kept, and the next link begins with the patches that then stick.
    """

    def __init__(self) -> None:
        self._state: _State | None = None

    def step(self, t_ns: int, patches: Mapping[str, Patch]) -> ObjectMotion | None:
        """Take all patches at a time, by a key that each keeps while it touches;
        return None if nothing touches.
        """
        if not patches:
            self._state = None
            return None
        stick = {key: patch for key, patch in patches.items() if not patch.slips}
        state = self._state
        if state is None:
            link = _begun(_Patches(stick.values()))
            none = np.zeros((6, 6))
            unobserved = _unobserved(link, none)
            whole = (t_ns, link.middle_mm, shift(0.0, 0.0, 0.0), none)
            state = _State(*whole, link, t_ns, unobserved, stick, t_ns, _Motion())
        else:
            if stick.keys() != state.seen.keys():
                # The motion since the last instant shows in the patches that still stick.
                both = {key: patch for key, patch in state.seen.items() if key in stick}
                state = _next_link(_fitted(_next_link(state, both), t_ns, stick), stick)
            state = _fitted(state, t_ns, stick)
        self._state = state
        return _reported(state)


def _next_link(state: _State, seen: Mapping[str, Patch]) -> _State:
    """Keep the motion so far, and begin another link at these patches."""
    link, base, motion, about_mm = (
        _begun(_Patches(seen.values())),
        state.whole(),
        state.motion,
        state.about_mm,
    )
    unseen_mm = min(UNKNOWN_SD_MM, UNSEEN_MM_S * (state.seen_ns - state.began_ns) / 1e9)
    way = np.append(motion.translation_mm, LEVER_MM * turned_rad(motion.rotation))
    moved_sd_mm = SHEAR_SD_PART * float(np.linalg.norm(way))
    # Passed on whole, covariances of errors that both links share added up: ten minutes of a
    # flickering finger made every direction unobservable. As it is, after a finger left, joined or
    # slipped, the 90 % ellipsoid held 90, 85 and 92 % of the motions.
    spread = _spread(state, unseen_mm, max(REST_SHARE, moved_sd_mm / (SHEAR_SD_MM + moved_sd_mm)))
    if seen:
        amid_mm = base.inverse().apply(link.middle_mm)
        change_mm = (base.rotation - np.eye(3)) @ (amid_mm - about_mm)
        about_mm = amid_mm if np.linalg.norm(change_mm) < RECENTRED_MM else about_mm
    whole, unobserved = (state.since_ns, about_mm, base, spread), _unobserved(link, spread)
    return _State(*whole, link, state.seen_ns, unobserved, seen, state.seen_ns, _Motion())


def _fitted(state: _State, t_ns: int, stick: Mapping[str, Patch]) -> _State:
    """Fit the link's motion to its patches now."""
    seen = {key: stick[key] for key in state.seen}
    return replace(
        state,
        seen=seen,
        seen_ns=t_ns,
        motion=_solved(state.link, _Patches(seen.values()), state.motion),
    )


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
        to_origin @ (share * motion.covariance + blind @ blind.T) @ to_origin.T
        + carried @ state.spread @ carried.T
    )


def _moved_to(place_mm: F64) -> F64:
    """The matrix (6, 6) that converts a small motion about the origin
    to one about another place.
    """
    x, y, z = place_mm.tolist()
    change = np.eye(6)
    change[:3, 3:] = ((0.0, z, -y), (-z, 0.0, x), (y, -x, 0.0))
    return change


def _unobserved(link: _Link, spread: F64) -> tuple[Unobserved, ...]:
    """The motions that a link and those before it do not show."""
    change = _moved_to(link.middle_mm)
    before = change @ spread @ change.T * np.outer(_SCALE, _SCALE)
    values, directions = np.linalg.eigh(
        before + UNKNOWN_SD_MM**2 * (link.unobserved @ link.unobserved.T)
    )
    return tuple(
        _line(directions[:, i], link.middle_mm) for i in np.flatnonzero(values > OBSERVED_SD_MM**2)
    )


def _line(direction: F64, middle_mm: F64) -> Unobserved:
    """The line of a small motion about the middle:
    resting patches lie on it, so it is hardly a screw.
    """
    translation_mm, rotation = direction[:3], direction[3:] / LEVER_MM
    size = float(np.linalg.norm(rotation))
    far_mm, along_mm = float(np.linalg.norm(translation_mm)), abs(float(translation_mm @ rotation))
    if far_mm > FARTHEST_LINE_MM * size or along_mm > LEVER_MM * size**2:
        x, y, z = (translation_mm / far_mm).tolist()
        return Unobserved((x, y, z), None)
    x, y, z = (rotation / size).tolist()
    a, b, c = (middle_mm + np.cross(rotation, translation_mm) / size**2).tolist()
    return Unobserved((x, y, z), (a, b, c))


def _reported(state: _State) -> ObjectMotion:
    whole = state.whole()
    now_mm = whole.apply(state.about_mm)
    change = _moved_to(now_mm)
    translation_mm, rotation_rad = now_mm - state.about_mm, turned_rad(whole.rotation)
    gained = GAIN_SD * np.concatenate((translation_mm, rotation_rad))
    # The gain of all fingers together, which no number of them averages out.
    covariance = change @ _spread(state, UNKNOWN_SD_MM, 1.0) @ change.T + np.outer(gained, gained)
    return ObjectMotion(
        state.since_ns, state.about_mm, translation_mm, rotation_rad, covariance, state.unobserved
    )
