"""Track objects from frame to frame: a number for each while it touches, and its slip.

The mean of the touched skin's places in the reference, the imprint's place in the material, stands
still while an object holds its skin, and moves with the speed of the slip when it slides. Friction
drags the skin in the direction of the slide: an imprint that moves over undragged skin, or against
its drag, belongs to a contact that grows or shrinks on one side. Skin that goes back faster than
its depth explains is being unloaded: else a shaken object would seem to slip.

Two objects that touch may be one contact in some frames. An object that is joined to another keeps
its number for when they part again, and no speed is measured across a change of parts, which moves
every mean.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from operator import add, mul

from tacshade_edge.types import Reconstruction, Slip, TouchedObject

LEAST_DEPTH_MM = 0.2  # to divide by; less is noise
# Spans over which a speed is measured. The shortest that stands out of the noise shows a slip: a
# fast one within 100 ms at 30 frames a second or more.
SPANS_NS = (70_000_000, 150_000_000, 250_000_000)
LEAST_FRAMES = 3
SLIP_MM_S = 3.0  # least speed of the imprint over the material that is a slip
LEAST_SHEAR_MM = 0.3  # least drag of the skin under a sliding contact
FULL_PART = 0.6  # least part of its motion that a wholly sliding contact makes over the material
# Speeds from noise alone are below this many deviations in all but one of a million frames.
NOISE_SPREADS = 5.5
FIRST_NOISE_MM, NOISE_FRAMES = 0.06, 32
"""Initial noise of an imprint's place along each axis,
and the number of frames over which it is learned.
"""
PARTIAL_STRAIN = 0.12  # ratio of strain to shear above which only part of the contact holds
PARTIAL_MM = 0.15
REACH_MM = 4.0  # greatest distance of an object's place from that a frame ago


def follow(tracker: ContactTracker, result: Reconstruction) -> Reconstruction:
    """Add the results of tracking to a reconstruction's objects; without shear it stays the same.

    A frame whose depth is unknown (`touched`) neither ends nor begins an object:
    the next contact continues.
    """
    if result.touched or any(touched.shear_mm is None for touched in result.objects):
        return result
    return replace(result, objects=tracker.step(result.t_ns, result.objects))


_Seen = deque[tuple[int, float, float, float, float, float]]


@dataclass(slots=True, eq=False)
class _Track:
    number: int
    # Time, the imprint's place in the material, the contact's place, depth.
    seen: _Seen = field(default_factory=deque)
    noise_mm2: float = FIRST_NOISE_MM**2
    at_mm: tuple[float, float] = (0.0, 0.0)
    extent_mm: tuple[float, float] = (0.0, 0.0)

    def away_mm(self, touched: TouchedObject) -> float:
        """Distance of an object from this one a frame ago; infinite if it is another object."""
        away_mm = math.dist(self.at_mm, touched.centroid_mm[:2])
        joined = _within(touched.centroid_mm, self) or _holds(touched, self)
        return away_mm if away_mm <= REACH_MM or joined else math.inf


def _within(place_mm: Sequence[float], track: _Track) -> bool:
    """Whether a place lies in the box of an object a frame ago."""
    return _in_box(place_mm, track.at_mm, track.extent_mm)


def _holds(touched: TouchedObject, track: _Track) -> bool:
    """Whether the place of an object a frame ago lies in the box of an object now."""
    return _in_box(track.at_mm, touched.centroid_mm, touched.extent_mm)


def _in_box(
    place_mm: Sequence[float], middle_mm: Sequence[float], extent_mm: Sequence[float]
) -> bool:
    return all(abs(place_mm[k] - middle_mm[k]) < extent_mm[k] / 2 for k in range(2))


class ContactTracker:
    """Follows the objects of one stream of frames."""

    def __init__(self) -> None:
        self._tracks: list[_Track] = []
        self._joined: list[_Track] = []  # parts of other objects now
        self._count = 0

    def step(self, t_ns: int, objects: Sequence[TouchedObject]) -> tuple[TouchedObject, ...]:
        """Give a frame's objects, which have shear, a number that is never used again, slip, its
        speed (None until known).
        """
        left, followed = [*self._tracks, *self._joined], []
        for touched in objects:
            # The largest objects choose first: they are given in order of area.
            track = min(left, key=lambda one: one.away_mm(touched), default=None)
            if track is None or math.isinf(track.away_mm(touched)):
                self._count += 1
                track = _Track(self._count)
            else:
                left.remove(track)
            followed.append(track)
        pairs = list(zip(followed, objects, strict=True))
        self._restart_parted(pairs)
        self._join(left, pairs)
        self._tracks = followed
        return tuple(_followed(track, t_ns, touched) for track, touched in pairs)

    def _restart_parted(self, pairs: Sequence[tuple[_Track, TouchedObject]]) -> None:
        """Forget the way of an object from which another has parted; both begin anew."""
        for track, touched in pairs:
            if track in self._tracks:
                continue
            for other, _ in pairs:
                if other in self._tracks and _within(touched.centroid_mm, other):
                    other.seen.clear()
            track.seen.clear()

    def _join(self, left: Sequence[_Track], pairs: Sequence[tuple[_Track, TouchedObject]]) -> None:
        """Keep the objects of a frame ago whose places other objects have taken in, as parts of
        those, with which they move. The other ones have ended.
        """
        joined = []
        for part in left:
            for track, touched in pairs:
                if not _holds(touched, part):
                    continue
                if part in self._tracks:
                    track.seen.clear()
                else:
                    by_mm = (touched.centroid_mm[k] - track.at_mm[k] for k in range(2))
                    x_mm, y_mm = map(add, part.at_mm, by_mm)
                    part.at_mm = (x_mm, y_mm)
                joined.append(part)
                break
        self._joined = joined


def _followed(track: _Track, t_ns: int, touched: TouchedObject) -> TouchedObject:
    """Add a frame to a track."""
    shear_mm, depth_mm = touched.shear_mm, touched.depth_max_mm
    assert shear_mm is not None
    track.at_mm, track.extent_mm = touched.centroid_mm[:2], touched.extent_mm[:2]
    held = track.at_mm[0] - shear_mm[0], track.at_mm[1] - shear_mm[1]
    if track.seen and t_ns <= track.seen[-1][0]:
        track.seen.clear()  # another stream
    track.seen.append((t_ns, *held, *track.at_mm, depth_mm))
    # At a low frame rate, the least number of frames spans more than the longest span.
    while len(track.seen) > LEAST_FRAMES and track.seen[-1][0] - track.seen[0][0] > SPANS_NS[-1]:
        track.seen.popleft()
    track.noise_mm2 += (_noise_mm2(track.seen, track.noise_mm2) - track.noise_mm2) / NOISE_FRAMES
    slides, speed = _slide(track.seen, track.noise_mm2, shear_mm)
    partly = (touched.strain_mm or 0.0) > max(PARTIAL_MM, PARTIAL_STRAIN * math.hypot(*shear_mm))
    slip = Slip.FULL if slides else Slip.PARTIAL if partly else Slip.STICK
    return replace(touched, id=track.number, slip=slip, slip_mm_s=speed)


def _noise_mm2(seen: _Seen, known_mm2: float) -> float:
    """Variance along an axis from the last second difference, in which uniform motion cancels."""
    if len(seen) < LEAST_FRAMES:
        return known_mm2
    a, b, c = (seen[at][1:3] for at in range(-LEAST_FRAMES, 0))
    # A second difference has the variance 6 σ² (1 + 4 + 1), and there are two axes.
    return sum((p - 2 * q + r) ** 2 for p, q, r in zip(a, b, c, strict=True)) / 12


def _slide(
    seen: _Seen, noise_mm2: float, shear_mm: tuple[float, float]
) -> tuple[bool, float | None]:
    """Whether the whole contact slides, and the least-squares speed of its imprint over the
    material (None until known).
    """
    if len(seen) < LEAST_FRAMES:
        return False, None
    size = math.hypot(*shear_mm)
    way_x, way_y = (part / size if size >= LEAST_SHEAR_MM else 0.0 for part in shear_mm)
    t_ns, *places = zip(*seen, strict=True)
    speed = 0.0
    # Undragged skin does not slide: only its speed is wanted.
    for span_ns in SPANS_NS if size >= LEAST_SHEAR_MM else SPANS_NS[-1:]:
        first = min(bisect_left(t_ns, t_ns[-1] - span_ns), len(seen) - LEAST_FRAMES)
        t_s = [(each - t_ns[-1]) * 1e-9 for each in t_ns[first:]]
        mean_s = sum(t_s) / len(t_s)
        t_s = [each - mean_s for each in t_s]
        spread = sum(map(mul, t_s, t_s))
        if spread <= 0:
            return False, None
        held_x, held_y, moved_x, moved_y, deeper = (
            sum(map(mul, t_s, place[first:])) / spread for place in places
        )
        speed = math.hypot(held_x, held_y)
        # By Coulomb's law a sliding contact bears its limit, which follows its depth: skin that
        # goes back faster than the depth explains is being unloaded. Without this, a shaken object
        # would seem to slip whenever it swings back, because networks underestimate how far its
        # place moves with its drag.
        loosened = size * max(0.0, -deeper) / max(places[-1][-1], LEAST_DEPTH_MM)
        moved = moved_x * way_x + moved_y * way_y
        slid = min(held_x * way_x + held_y * way_y, moved + loosened)
        if slid >= max(SLIP_MM_S, NOISE_SPREADS * math.sqrt(noise_mm2 / spread), FULL_PART * moved):
            return True, speed
    return False, speed
