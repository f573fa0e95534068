"""Named settings of the reconstruction, each a trade of speed against accuracy."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, Literal

from tacshade_edge.sensor.geometry import disc_map

Outline = Literal["network", "kmeans"]
"""What separates the contact from the other skin: the network's log odds of contact, or the paper's
two means of the heights (section V-A)."""
NETWORK: Final[Outline] = "network"
KMEANS: Final[Outline] = "kmeans"

# In place of a profile: the daemon switches between those of `LADDER` by a latency budget.
AUTO = "auto"


@dataclass(frozen=True, slots=True)
class Profile:
    """The settings behind a name: the key of ``sensor.depth.SOLVERS`` and the name of its network,
    if it has one.
    """

    name: str
    solver: str
    stride_px: int  # of eq. 1, and so of every later map
    # Side of eq. 1's window. Whole pitches, so that the pattern itself averages out: the ripple on
    # a flat skin falls from 5 to 50 grey levels to half a level.
    window_pitches: int
    tv_weight: float  # of the total-variation denoising, in units of g/255; 0 for none
    halved: bool = False  # work on means over 2x2 px of every camera, not only of noisy ones
    cells: int = disc_map.CELLS  # along a side of the network's map
    network: str | None = None
    outline: Outline = NETWORK


DEFAULT = "balanced"  # the profile if the user names none

_LEARNED = Profile(
    "accurate", "learned", stride_px=4, window_pitches=2, tv_weight=0.0, network="accurate"
)
PROFILES: dict[str, Profile] = {
    p.name: p
    for p in (
        Profile(
            # Section IV-A slides the window "with a specific stride". The window averages two
            # pitches, so a map of every pixel would hold no more, and eq. 11's outliers, which
            # normalise the map, are rarer on fewer cells (docs/explanation/numerics.md).
            "paper",
            "hybrid_sfs",
            stride_px=4,
            window_pitches=2,
            tv_weight=0.1,
            outline=KMEANS,
        ),
        replace(_LEARNED, name="fast", network="fast", halved=True, cells=56),
        replace(_LEARNED, name="balanced", network="balanced", halved=True),
        _LEARNED,
    )
}

# `paper` with the height of eq. 10's g_hn itself: what eq. 11 adds shows beside it.
PAPER_WITHOUT_EQ_11 = replace(PROFILES["paper"], name="paper without eq. 11", solver="shape_grey")


def profile_with(name: str, outline: Outline) -> Profile:
    """A profile by name, with an outline; `paper` always has its two means."""
    profile = PROFILES[name]
    return profile if profile.outline == outline else replace(profile, outline=KMEANS)


# Of the pictures that gate and judges see. For learned profiles, eq. 1 serves these alone.
GATE = replace(_LEARNED, name="gate", network=None, halved=True)

# Of `AUTO`, the most accurate first: it steps down, and up again.
LADDER: tuple[str, ...] = tuple(
    name for name in ("accurate", "balanced", "fast") if name in PROFILES
)
