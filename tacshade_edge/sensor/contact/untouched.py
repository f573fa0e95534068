"""Frames in which nothing touches, as a running sensor shows them, and the limits that they set.

The limits themselves must not choose the frames, or they would only ever shrink: a frame beyond
them, in a stretch without a touch, counts like any other.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.contact.gate import SURE_PART
from tacshade_edge.sensor.contact.rest import (
    FALSE_CONTACTS,
    WAYS,
    Evidence,
    limits_of,
    moved_by_a_pixel,
)
from tacshade_edge.types import U8, Frame, Reconstruction, RestLimits, frozen

UNTOUCHED_FRAMES = 10
REST_S = 10.0
"""Without a contact before and after: a dent after a release is gone after 3 s; a soft skin under a
long press needs a little more."""
PERIOD_S = 60.0  # what the reference follows changes over minutes and years
GAP_S = 3.0  # after a longer gap between frames, nobody knows what touched
MOMENT_S = 0.5
"""What exceeds the limits for so long at most, between two frames within them, is no touch: noise
and shocks are shorter, taps of which the map shows nothing mostly longer."""
MEASURED_EVERY = 2  # frames: neighbours show much the same, and each takes as long as a contact

Measured = tuple[str, Evidence]
"""A profile's name, and what it finds in an image."""


@frozen
class Untouched:
    """Frames of a sensor at rest, and what a profile finds in some of them, and in the first one
    moved by a pixel in one of the `WAYS`.
    """

    images: list[U8]
    profile: str
    evidence: tuple[Evidence, ...]
    way: int
    moved: tuple[Evidence, ...]
    end_ns: int


class UntouchedFrames:
    """Ten frames of a sensor at rest once per `PERIOD_S` of the frames' time; a touched, invalid or
    doubtful frame ends them. One thread passes in every frame, another may take the result.
    `measure` is called in the former, for some of the ten.
    """

    def __init__(self, measure: Callable[[U8], Measured | None] = lambda image: None) -> None:
        self._measure = measure
        self.at_rest = False  # nothing touched in the latest frame
        self.discarded = 0  # batches that were begun and not finished
        self._images: list[U8] = []
        self._measured: list[Measured | None] = []
        self._moved: Measured | None = None
        self._way = 0
        # Set by one thread while it is None, cleared by the other: without a lock, as each is one
        # assignment.
        self._finished: Untouched | Reason | None = None
        self._last_ns: int | None = None
        self._free_ns: int | None = None  # the latest frame within the limits
        self._touched_ns = self._due_ns = 0

    def take(self) -> Untouched | Reason | None:
        """The frames, or the doubt about one of them; None if there are none. Until taken, they
        block further ones.
        """
        if (finished := self._finished) is not None:
            self._finished = None
        return finished

    def untouched_since(self, t_ns: int) -> bool | None:
        """Whether nothing has touched for `REST_S` since a time; None if that is not yet known."""
        if self._touched_ns > t_ns:
            return False
        rested = self._last_ns is not None and self._last_ns - t_ns >= REST_S * 1e9
        return True if rested else None

    def see(self, frame: Frame, result: Reconstruction | None) -> None:
        """See a frame; the result is None for a contact whose depth nobody needs."""
        now_ns, last_ns = frame.t_ns, self._last_ns
        self._last_ns = now_ns
        known = last_ns is not None and 0 <= now_ns - last_ns <= GAP_S * 1e9
        usable = result is not None and result.valid and not result.contact
        self.at_rest = usable and not (result is not None and result.touched)
        if self.at_rest:
            self._free_ns = now_ns
        free_ns = self._free_ns
        untouched = usable and free_ns is not None and now_ns - free_ns <= MOMENT_S * 1e9
        if not known or not untouched:
            self._touched_ns = now_ns
            self._discard()
        elif self._finished is None and now_ns >= max(
            self._due_ns, self._touched_ns + int(REST_S * 1e9)
        ):
            # A frame beyond the limits is degraded by that alone.
            doubt = result.degraded if result and self.at_rest else None
            if doubt:
                self._discard()
                self._finish(doubt, now_ns)
            else:
                self._collect(frame.image)
                if self.at_rest and len(self._images) == UNTOUCHED_FRAMES:
                    self._finish(self._batch(now_ns), now_ns)

    def _collect(self, image: U8) -> None:
        at = len(self._images)
        if at == UNTOUCHED_FRAMES:
            return
        if at == 0:
            # One way for each batch: all four would take as long as the frames themselves.
            self._moved = self._measure(moved_by_a_pixel(image, self._way))
        if at % MEASURED_EVERY == 0:
            self._measured.append(self._measure(image))
        self._images.append(image)

    def _batch(self, now_ns: int) -> Untouched:
        found = [one for one in self._measured if one is not None]
        profile = found[-1][0] if found else ""
        moved = () if self._moved is None or self._moved[0] != profile else (self._moved[1],)
        evidence = tuple(one for name, one in found if name == profile)
        return Untouched(self._images, profile, evidence, self._way, moved, now_ns)

    def _finish(self, finished: Untouched | Reason, now_ns: int) -> None:
        self._due_ns = now_ns + int(PERIOD_S * 1e9)
        self._way = (self._way + 1) % WAYS
        self._images, self._measured, self._moved = [], [], None
        self._finished = finished

    def _discard(self) -> None:
        self.discarded += bool(self._images)
        self._images, self._measured, self._moved = [], [], None


ENOUGH_FRAMES = 100
"""Measured ones, which take at least 20 minutes."""
KEPT_BATCHES = 200
FACTOR = 2.0
"""How far the limits of a running sensor may go from the first ones, up and down: a touch that is
too light and slow to be noticed must not widen them, nor a robot that stands still overnight make
them those of a robot that stands still."""
LEAST_MM, LEAST_CHANGE = 0.02, 0.01
"""The scale of limits on heights and on local changes that are near zero."""
WORTH = 0.2  # a smaller change is not worth a new calibration number


class RestLearner:
    """Learns the limits of one profile from the sensor's latest untouched frames."""

    def __init__(self) -> None:
        self._batches: deque[Untouched] = deque(maxlen=KEPT_BATCHES)

    @property
    def frames(self) -> int:
        """How many frames it knows."""
        return sum(len(batch.evidence) for batch in self._batches)

    def add(self, batch: Untouched) -> None:
        """Learn from a batch; its images are not kept."""
        # 200 batches of ten images in colour would take two gigabytes.
        self._batches.append(replace(batch, images=[]))

    def limits(self, first: RestLimits | None) -> RestLimits | None:
        """The limits, within `FACTOR` of the first ones, the calibration's own or the first that
        were learnt; None if there are too few frames.
        """
        if self.frames < ENOUGH_FRAMES:
            return None
        evidence = [one for batch in self._batches for one in batch.evidence]
        moved = [
            [one for batch in self._batches if batch.way == way for one in batch.moved]
            for way in range(WAYS)
        ]
        rate = first.false_contacts if first else FALSE_CONTACTS
        made = limits_of(evidence, moved, rate)
        return made if made is None or first is None else within(made, first)


def within(made: RestLimits, first: RestLimits) -> RestLimits:
    """Limits kept within `FACTOR` of the first ones."""

    def kept(value: float, about: float, least: float) -> float:
        # A factor of a limit near zero, or below, leaves no room.
        room = (FACTOR - 1) * max(abs(about), least)
        return min(max(value, about - room / FACTOR), about + room)

    return replace(
        made,
        height_mm=kept(made.height_mm, first.height_mm, LEAST_MM),
        local_change=kept(made.local_change, first.local_change, LEAST_CHANGE),
        changed_part=max(kept(made.changed_part, first.changed_part, SURE_PART), SURE_PART),
    )


def worth(present: RestLimits | None, made: RestLimits) -> bool:
    """Whether other limits differ enough from the present ones."""
    if present is None:
        return True
    pairs = (
        (present.height_mm, made.height_mm, LEAST_MM),
        (present.local_change, made.local_change, LEAST_CHANGE),
        (present.changed_part, made.changed_part, SURE_PART),
    )
    return any(abs(new - old) > WORTH * max(abs(old), least) for old, new, least in pairs)
