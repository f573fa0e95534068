"""The settings of the study: the shipped profiles, and variations of each in one or two parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from tacshade_edge.core.depth import Depth
from tacshade_edge.core.depth.hybrid_sfs import HybridSfs, finite_shape_grey, hybrid_depth, scaled
from tacshade_edge.core.image.preprocess import GreyMaps
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import load_network
from tacshade_edge.types import Calibration


def scaled_grey(maps: GreyMaps, alpha_mm: float) -> Depth:
    """The depth α g_hn, in place of `hybrid_sfs.hybrid_depth`: the starting point of the iterations of eq. 11."""
    g_hn, bad = finite_shape_grey(maps)
    return scaled(g_hn.astype(np.float64), alpha_mm, bad)


WORDS: dict[str, Callable[[Any], str]] = {
    "solver": "solver {}".format,
    "halved": lambda halved: "halved" if halved else "not halved",
    "stride_px": "stride {} px".format,
    "window_pitches": "window {} pitch".format,
    "tv_weight": "TV {:g}".format,
}
"""The varied fields, and a formatter of each."""

# A frame takes half a second at stride 1; only the decisive variations use it.
_AROUND_PAPER: tuple[dict[str, Any], ...] = (
    {"scaled_grey": True},
    {"halved": True},
    {"stride_px": 4},
    {"stride_px": 8},
    {"stride_px": 4, "window_pitches": 1},
    {"stride_px": 4, "tv_weight": 0.0},
    {"stride_px": 4, "scaled_grey": True},
)


@dataclass(frozen=True, slots=True)
class Setting:
    """A way to reconstruct."""

    profile: Profile  # a shipped one, or a variation with its name, network and factor
    scaled_grey: bool = False  # the paper's method without eq. 11

    @property
    def shipped(self) -> bool:
        """Whether a user can choose the setting by name."""
        return self == Setting(PROFILES[self.profile.name])

    @property
    def fields(self) -> dict[str, Any]:
        """The fields that may vary (`WORDS`), with their values."""
        solver = {"solver": "grey"} if self.scaled_grey else {}
        return {field: getattr(self.profile, field) for field in WORDS} | solver

    @property
    def varied(self) -> str:
        """The differences from the shipped profile; empty for that profile itself."""
        base = Setting(PROFILES[self.profile.name]).fields
        words = [WORDS[field](value) for field, value in self.fields.items() if value != base[field]]
        return ", ".join(words)

    def __str__(self) -> str:
        """The setting's name for people, unique in a grid."""
        return ", ".join(filter(None, (self.profile.name, self.varied)))


def grid(names: Sequence[str]) -> tuple[Setting, ...]:
    """The shipped profiles of these names, each followed by its variations."""
    settings = []
    for profile in (PROFILES[name] for name in names):
        around = ({"halved": not profile.halved},) if profile.network else _AROUND_PAPER
        settings.append(Setting(profile))
        settings += [_changed(profile, changes) for changes in around]
    return tuple(settings)


def _changed(profile: Profile, changes: Mapping[str, Any]) -> Setting:
    own = {field: value for field, value in changes.items() if field in Setting.__dataclass_fields__}
    return Setting(replace(profile, **{field: changes[field] for field in changes.keys() - own.keys()}), **own)


def make(setting: Setting, calibration: Calibration) -> Reconstructor:
    """Make the reconstructor of a setting, with its own network if it needs one."""
    profile = setting.profile
    if profile.network:
        return Reconstructor(calibration, profile, load_network(profile.network))
    return Reconstructor(
        calibration,
        profile,
        make_solver=partial(HybridSfs, depth=scaled_grey if setting.scaled_grey else hybrid_depth),
    )
