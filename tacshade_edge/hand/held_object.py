"""The fingers' reports as patches of the one object that they hold, and its motion as the hand publishes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from tacshade_edge.core.hand.object_motion import ObjectMotion, ObjectTracker
from tacshade_edge.core.hand.patch import Patch
from tacshade_edge.protocol.hand import Finger, Motion, Unobservable, rounded_triple
from tacshade_edge.types import Slip

PATCHES_MAX: Final = 4
"""Patches of one finger, the greatest first: the message of five fingers stays within the decoder's limit."""
PERIOD_NS: Final = 10_000_000
"""Shortest time between two fits: five cameras that do not expose together cause up to 250 messages a second."""
STALE_NS: Final = 500_000_000
"""A finger in contact reports every frame; one that has reported none for this long holds nothing."""
_DIGITS: Final = 8  # decimal places of a variance
_DEGREES: Final = np.array([1.0] * 3 + [180 / np.pi] * 3)


class HeldObject:
    """The held object, followed from message to message."""

    def __init__(self) -> None:
        self._tracker = ObjectTracker()
        self._motion: Motion | None = None
        self._fitted_ns = 0

    def step(self, fingers: Mapping[str, Finger], now_ns: int) -> Motion | None:
        """Take all fingers' latest reports and return the motion; None if no touching skin has shear."""
        patches = patches_of({k: f for k, f in fingers.items() if f.t_ns is not None and now_ns - f.t_ns <= STALE_NS})
        if not patches or not 0 <= now_ns - self._fitted_ns < PERIOD_NS:
            self._fitted_ns = now_ns
            found = self._tracker.step(max(finger.t_ns or 0 for finger in fingers.values()), patches)
            slipping = dict.fromkeys(key.rpartition(" ")[0] for key, patch in patches.items() if patch.slips)
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
                *(o.centroid_mm, o.normal, finger.axis, o.shear_mm, o.depth_max_mm, o.twist_deg),
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
                through_mm=None if line.through_mm is None else rounded_triple(np.array(line.through_mm)),
            )
            for line in found.unobserved
        ),
        left_out=left_out,
    )
