"""Measure the evidence of a touch on images of the untouched skin,
for every profile with a network.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import counted
from tacshade_edge.sensor.contact.rest import (
    FALSE_CONTACTS,
    LEAST_FRAMES,
    WAYS,
    Evidence,
    limits_of,
    moved_by_a_pixel,
)
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Calibration, RestLimits


@dataclass(frozen=True, slots=True)
class LearntRest:
    """The limits by profile, and a line for each image that was left out."""

    limits: dict[str, RestLimits]
    left_out: tuple[str, ...]


def learn_rest(
    calibration: Calibration,
    images: Iterable[tuple[str, U8]],
    false_contacts: float = FALSE_CONTACTS,
) -> LearntRest:
    """Measure the limits on images with their names.

    Raises ConfigError if too few of them can be used.
    """
    bare = replace(calibration, rest={})
    makers = {
        name: make_reconstructor(bare, profile)
        for name, profile in PROFILES.items()
        if profile.network
    }
    taken: dict[str, list[Evidence]] = {name: [] for name in makers}
    moved: dict[str, list[list[Evidence]]] = {name: [[] for _ in range(WAYS)] for name in makers}
    # A dictionary keeps the order, and a line once: every profile refuses a black image.
    left_out: dict[str, None] = {}
    for at, (name, image) in enumerate(images):
        # Each image one way: all four of each would take more than twice as long.
        shifted = moved_by_a_pixel(image, at % WAYS)
        for profile, made in makers.items():
            found, drifted = made.evidence(image), made.evidence(shifted)
            if isinstance(found, Evidence):
                taken[profile].append(found)
            else:
                left_out[f"{name}: {found}"] = None
            if isinstance(drifted, Evidence):
                moved[profile][at % WAYS].append(drifted)
    limits = {name: limits_of(some, moved[name], false_contacts) for name, some in taken.items()}
    usable = {name: one for name, one in limits.items() if one is not None}
    if len(usable) < len(limits):
        fewest = counted(min(map(len, taken.values())), "usable image")
        why = f" ({next(iter(left_out))})" if left_out else ""
        raise ConfigError(
            f"found {fewest} of the untouched skin{why}, expected at least {LEAST_FRAMES}"
        )
    return LearntRest(usable, tuple(left_out))
