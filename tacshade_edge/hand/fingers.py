"""Combines the fingers' reports, live and from recordings. Pure: the caller passes in the time."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import repeat
from typing import Final

import numpy as np

from tacshade_edge.hand.object_tracking import ObjectMotion, ObjectTracker, Patch
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Slip
from tacshade_edge.wire.hand_messages import away, rounded_triple
from tacshade_edge.wire.hand_topics import Finger, HandObjects, Motion, Unobservable

# Of a finger, the greatest first: a message of five fingers stays within the decoder's limit.
PATCHES_MAX: Final = 4
PERIOD_NS: Final = 10_000_000
"""Shortest time between two fits: five cameras that do not expose together cause up
to 250 messages a second.
"""
STALE_NS: Final = 500_000_000
"""A finger in contact reports every frame; one that has reported none
for this long holds nothing.
"""
_DIGITS: Final = 8  # decimal places of a variance
_DEGREES: Final = np.array([1.0] * 3 + [180 / np.pi] * 3)


class HeldObject:
    """The held object, followed from message to message."""

    def __init__(self) -> None:
        self._tracker = ObjectTracker()
        self._motion: Motion | None = None
        self._fitted_ns = 0

    def step(self, fingers: Mapping[str, Finger], now_ns: int) -> Motion | None:
        """Take all fingers' latest reports and return the motion;
        None if no touching skin has shear.
        """
        patches = patches_of(
            {k: f for k, f in fingers.items() if f.t_ns is not None and now_ns - f.t_ns <= STALE_NS}
        )
        # The end of all contacts is never skipped: the object is let go.
        if not patches or not 0 <= now_ns - self._fitted_ns < PERIOD_NS:
            self._fitted_ns = now_ns
            found = self._tracker.step(
                max(finger.t_ns or 0 for finger in fingers.values()), patches
            )
            slipping = dict.fromkeys(
                key.rpartition(" ")[0] for key, patch in patches.items() if patch.slips
            )
            self._motion = None if found is None else _published(found, tuple(slipping))
        return self._motion


def patches_of(fingers: Mapping[str, Finger]) -> dict[str, Patch]:
    """The fingers' objects as patches, by a key that each keeps while it touches."""
    return {
        f"{name} {number}": patch
        for name, finger in fingers.items()
        if finger.state == "contact"
        for number, patch in _patches(finger)
    }


def with_motion(finger: Finger, motion: Motion | None) -> Finger:
    """Add the motion to each object of a finger that counts as a patch."""
    if motion is None or not finger.objects:
        return finger
    held = [number for number, _ in _patches(finger)]
    objects = (replace(o, motion=motion) if o.id in held else o for o in finger.objects)
    return replace(finger, objects=tuple(objects))


def _patches(finger: Finger) -> list[tuple[int, Patch]]:
    return [
        (
            o.id,
            Patch(
                o.centroid_mm,
                o.normal,
                finger.axis,
                o.shear_mm,
                o.depth_max_mm,
                o.twist_deg,
                slips=o.slip == Slip.FULL,
            ),
        )
        for o in finger.objects[:PATCHES_MAX]
        if o.id is not None and o.shear_mm is not None and finger.axis is not None
    ]


def _published(found: ObjectMotion, left_out: tuple[str, ...]) -> Motion:
    covariance = found.covariance * np.outer(_DEGREES, _DEGREES)
    return Motion(
        since_ns=found.since_ns,
        about_mm=rounded_triple(found.about_mm),
        translation_mm=rounded_triple(found.translation_mm),
        rotation_deg=rounded_triple(np.degrees(found.rotation_rad)),
        covariance=tuple(round(value, _DIGITS) for value in covariance.ravel().tolist()),
        unobservable=tuple(
            Unobservable(
                axis=rounded_triple(np.array(line.axis)),
                through_mm=None
                if line.through_mm is None
                else rounded_triple(np.array(line.through_mm)),
            )
            for line in found.unobserved
        ),
        left_out=left_out,
    )


GATHER_NS: Final = 3_000_000
"""Longest wait of a finger's news for other fingers in contact, whose next frame is due before
then; shortest time between two messages.
"""
# Longest time between two messages, without contact and change.
QUIET_PERIOD_NS: Final = 100_000_000
# Longest wait for a silent finger before the first message to a new listener.
FIRST_NS: Final = 500_000_000
# A finger that has reported nothing for this long is away, as in `status/camera`.
STALLED_NS: Final = 3_000_000_000

_STARTING: Final = away(
    Reason(ReasonCode.STARTING, "the hand has received nothing from this sensor yet")
)
_STALLED: Final = away(Reason(ReasonCode.STALLED, "the sensor has sent no report"))


class HandAggregator:
    """The latest report of every finger, and when the next message is due."""

    def __init__(self, names: Sequence[str]) -> None:
        self._fingers = dict.fromkeys(names, _STARTING)
        self._heard_ns: dict[str, int | None] = dict.fromkeys(names)
        self._period_ns = dict.fromkeys(names, 0)  # between the latest two reports
        self._listened_ns: int | None = None
        self._published_ns = 0
        self._news: set[str] = set()
        self._news_ns = 0  # when the oldest news came
        self._seq = 0
        self._held = HeldObject()

    def listen(self, now_ns: int, *, listened: bool) -> None:
        """Note whether anybody listens; when that begins, earlier reports no longer count."""
        if not listened:
            self._listened_ns = None
        elif self._listened_ns is None:
            self._listened_ns, self._published_ns, self._held = now_ns, 0, HeldObject()
            for name, finger in self._fingers.items():
                # Otherwise the first message would show a touch of when somebody last listened.
                self._heard_ns[name] = None
                if finger.state != "away":
                    self._fingers[name] = _STARTING

    def hear(self, name: str, finger: Finger, now_ns: int) -> None:
        before = self._fingers[name]
        self._period_ns[name] = now_ns - (self._heard_ns[name] or now_ns)
        self._fingers[name], self._heard_ns[name] = finger, now_ns
        changed = (finger.state, finger.touched) != (before.state, before.touched)
        if finger.state == "contact" or changed:
            self._news_ns = self._news_ns if self._news else now_ns
            self._news.add(name)

    def due_ns(self) -> int | None:
        """When the next message is due; None while nobody listens."""
        since_ns = self._listened_ns
        if since_ns is None:
            return None
        if self._published_ns == 0 and None in self._heard_ns.values():
            return since_ns + FIRST_NS
        if not self._news:
            return self._published_ns + QUIET_PERIOD_NS if self._published_ns else since_ns
        until_ns = self._news_ns + GATHER_NS
        # Only for a finger whose next frame is due in that time. Cameras do not expose together,
        # and each message once waited 3 ms for frames that could not come.
        waits = any(
            finger.state == "contact"
            and name not in self._news
            and (self._heard_ns[name] or 0) + self._period_ns[name] <= until_ns
            for name, finger in self._fingers.items()
        )
        return max(until_ns if waits else self._news_ns, self._published_ns + GATHER_NS)

    def message(self, now_ns: int, wall_ns: int) -> HandObjects:
        for name, finger in self._fingers.items():
            heard_ns = self._heard_ns[name] or self._listened_ns or now_ns
            if finger.state != "away" and now_ns - heard_ns > STALLED_NS:
                self._fingers[name] = _STALLED
        motion = self._held.step(self._fingers, now_ns)
        fingers = {}
        for name, finger in self._fingers.items():
            aged = None if finger.t_ns is None else round((now_ns - finger.t_ns) / 1e6, 3)
            fingers[name] = replace(with_motion(finger, motion), age_ms=aged)
        message = HandObjects(t_ns=now_ns, wall_ns=wall_ns, seq=self._seq, fingers=fingers)
        self._published_ns = now_ns
        self._news.clear()
        self._seq += 1
        return message


# A finger's `t_ns`, Unix time and report of each frame, in order.
Reports = Iterable[tuple[int, int, Finger]]


def messages(fingers: Mapping[str, Reports]) -> Iterator[HandObjects]:
    """The messages that the hand would have published for reports of one clock,
    each made exactly when it is due.
    """
    aggregator = HandAggregator(tuple(fingers))
    named = [zip(own, repeat(name)) for name, own in fingers.items()]
    reports = heapq.merge(*named, key=lambda each: each[0][0])
    now_ns = wall_minus_t_ns = 0
    # In the order in which the hand would have heard them; each recording is sorted already, so
    # no more than a report of each finger is in memory.
    for (t_ns, wall_ns, finger), name in reports:
        aggregator.listen(t_ns, listened=True)
        while (due_ns := aggregator.due_ns()) is not None and due_ns < t_ns:
            now_ns = max(now_ns, due_ns)
            yield aggregator.message(now_ns, now_ns + wall_minus_t_ns)
        now_ns, wall_minus_t_ns = t_ns, wall_ns - t_ns
        aggregator.hear(name, finger, t_ns)
    if (due_ns := aggregator.due_ns()) is not None:
        now_ns = max(now_ns, due_ns)
        yield aggregator.message(now_ns, now_ns + wall_minus_t_ns)
