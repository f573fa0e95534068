"""The settings that are tried: the shipped profiles, and what differs from one of them in a thing or two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from tacshade_edge.core.contact.objects import Region, bounding_box
from tacshade_edge.core.profiles import LEARNED, PROFILES, Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.devices.weights.network import load_network
from tacshade_edge.types import Bool, Calibration

WORDS: dict[str, Callable[[Any], str]] = {
    "solver": "solver {}".format,
    "halved": lambda halved: "halved" if halved else "not halved",
    "stride_px": "stride {} px".format,
    "window_pitches": "window {} pitch".format,
    "tv_weight": "TV {:g}".format,
    "tv_iterations": "TV {} times".format,
    "tv_precision": "TV {}".format,
}
"""Fields of a profile that are varied, and how that is said."""

_AROUND_LEARNED: tuple[dict[str, Any], ...] = (
    {"stride_px": 2},
    {"stride_px": 8},
    {"window_pitches": 1},
    {"window_pitches": 3},
)
# At stride 1 a frame takes half a second; around it only what decides.
_AROUND_PAPER: tuple[dict[str, Any], ...] = (
    {"solver": "grey"},
    {"tv_precision": "int16"},
    {"tv_precision": "float64"},
    {"solver": "grey", "tv_precision": "int16"},
    {"halved": True},
    {"stride_px": 2},
    {"stride_px": 4},
    {"stride_px": 8},
    {"stride_px": 4, "window_pitches": 1},
    {"stride_px": 4, "window_pitches": 3},
    {"stride_px": 4, "tv_weight": 0.0},
    {"stride_px": 4, "tv_weight": 0.05},
    {"stride_px": 4, "tv_weight": 0.2},
    {"stride_px": 4, "tv_iterations": 5},
    {"stride_px": 4, "tv_iterations": 10},
    {"stride_px": 4, "tv_precision": "int16"},
    {"stride_px": 4, "solver": "grey"},
)


@dataclass(frozen=True, slots=True)
class Setting:
    """A way to reconstruct.

    Attributes
    ----------
    profile : Profile
        A shipped one, or one that differs; its name stays that of the shipped one, whose network and factor it has.
    whole_disc : bool
        Objects are looked for everywhere in place of the contact's box.
    """

    profile: Profile
    whole_disc: bool = False

    @property
    def shipped(self) -> bool:
        """Whether a user can choose it by name."""
        return not self.whole_disc and self.profile == PROFILES[self.profile.name]

    @property
    def varied(self) -> str:
        """What differs from the shipped profile; empty for that one."""
        base = PROFILES[self.profile.name]
        mine = {field: getattr(self.profile, field) for field in WORDS}
        said = [WORDS[field](value) for field, value in mine.items() if value != getattr(base, field)]
        return ", ".join((*said, *(("whole disc",) if self.whole_disc else ())))

    def __str__(self) -> str:
        """Its name for a person, unique in a grid."""
        return ", ".join(filter(None, (self.profile.name, self.varied)))


def grid(names: Sequence[str]) -> tuple[Setting, ...]:
    """The shipped profiles of these names, each followed by what differs from it."""
    settings = []
    for profile in (PROFILES[name] for name in names):
        around = _AROUND_PAPER
        if profile.solver == LEARNED:
            around = ({"halved": not profile.halved}, *_AROUND_LEARNED)
        settings.append(Setting(profile))
        settings += [Setting(replace(profile, **changes)) for changes in around]
        settings.append(Setting(profile, whole_disc=True))
    return tuple(settings)


def make(setting: Setting, calibration: Calibration) -> Reconstructor:
    """A reconstructor of a setting, with a network of its own where it wants one."""
    profile = setting.profile
    network = load_network(profile.name) if profile.solver == LEARNED else None
    region: Region = _everywhere if setting.whole_disc else bounding_box
    return Reconstructor(calibration, profile, network, region)


def _everywhere(touched: Bool) -> tuple[slice, slice]:
    rows, cols = touched.shape
    return slice(0, rows), slice(0, cols)
