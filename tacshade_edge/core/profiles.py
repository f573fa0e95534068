"""Named settings of the reconstruction, each a trade of speed against accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tacshade_edge.core.geometry import disc_map

AUTO = "auto"
"""In place of a profile: the daemon switches between those of `LADDER` by a latency budget."""


@dataclass(frozen=True, slots=True)
class Profile:
    """The settings behind a name: the key of ``core.depth.SOLVERS`` and the name of its network, if it has one."""

    name: str
    solver: str
    stride_px: int  # of eq. 1, and so of every later map
    window_pitches: int  # side of eq. 1's window: whole pitches, so that the pattern itself averages out
    tv_weight: float  # of the total-variation denoising, in units of g/255; 0 for none
    # Least change of grey that opens the contact gate. A solver that finds the contact itself never took glare for one,
    # so its gate only has to stay closed for the dent after a release (at most 14.7 in 99 % of those of 0.2 mm).
    gate_levels: float
    # Least change away from contact that also opens it: the rim of a contact darkens even if a sensor hardly brightens
    # (of 885 presses of 1.5 mm the other level missed 4, with rims at least 10.8 below; a release leaves at most 8.7).
    gate_dark_levels: float = math.inf
    halved: bool = False  # means over 2x2 px of every camera, not only of noisy ones (`core.image.halving.is_halved`)
    cells: int = disc_map.CELLS  # along a side of the network's map
    network: str | None = None


DEFAULT = "balanced"
"""The profile if the user names none."""

# For learned profiles, eq. 1 serves only the gate.
_LEARNED = Profile(
    "accurate",
    "learned",
    stride_px=4,
    window_pitches=2,
    tv_weight=0.0,
    gate_levels=16,
    gate_dark_levels=10,
    network="accurate",
)
PROFILES: dict[str, Profile] = {
    p.name: p
    for p in (
        Profile("paper", "hybrid_sfs", stride_px=1, window_pitches=2, tv_weight=0.1, gate_levels=20),
        replace(_LEARNED, name="fast", network="fast", halved=True, cells=56),
        replace(_LEARNED, name="balanced", network="balanced", halved=True),
        _LEARNED,
    )
}

LADDER: tuple[str, ...] = tuple(name for name in ("accurate", "balanced", "fast") if name in PROFILES)
"""The profiles of `AUTO`, the most accurate and slowest first."""
