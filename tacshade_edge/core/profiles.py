"""Named settings of the reconstruction: one trade of speed for accuracy each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tacshade_edge.core.geometry import disc_map

AUTO = "auto"
"""In a profile's place: the daemon steps between those of `LADDER` by a latency budget."""


@dataclass(frozen=True, slots=True)
class Profile:
    """What a name stands for.

    Attributes
    ----------
    name : str
    solver : str
        Key of ``core.depth.SOLVERS``.
    network : str or None
        Name of the weights that the solver runs; None where it runs none.
    stride_px : int
        Stride of eq. 1 and so of every map after it.
    window_pitches : int
        Side of eq. 1's window, in marker pitches; whole, so that the pattern itself averages out.
    tv_weight : float
        Weight of the total-variation denoising, in units of g/255; 0 leaves it out.
    gate_levels : float
        Least change of grey that opens the contact gate. A solver that finds the contact itself took no glare for
        one, so its gate only has to stay shut for the dent that a release leaves (14.7 for 99 % of those of 0.2 mm).
    gate_dark_levels : float
        Least change away from contact that opens it too, inf for none: the rim of a contact darkens also where a sensor
        hardly brightens (of 885 presses of 1.5 mm the other level missed 4; their rims were 10.8 or more below, what a
        release of 0.2 mm leaves 8.7 at most).
    halved : bool
        Work on means over 2x2 px, where the pattern is coarse enough (`core.image.halving`).
    cells : int
        Along a side of the map that a network works on.
    """

    name: str
    solver: str
    stride_px: int
    window_pitches: int
    tv_weight: float
    gate_levels: float
    gate_dark_levels: float = math.inf
    halved: bool = False
    cells: int = disc_map.CELLS
    network: str | None = None


DEFAULT = "balanced"
"""What a user gets who names none."""

# Eq. 1 serves the gate of the learned ones only.
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
"""What `AUTO` steps between, the most accurate and dearest first."""
