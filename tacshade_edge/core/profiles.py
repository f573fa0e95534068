"""Named settings of the reconstruction: one trade of speed for accuracy each."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.image.total_variation import ITERATIONS_MAX, Precision

LEARNED = "learned"
"""The solver that takes the white pixels and finds the contact too, with the network of the profile's name."""

AUTO = "auto"
"""In a profile's place: the daemon steps between those of `LADDER` by a latency budget."""


@dataclass(frozen=True, slots=True)
class Profile:
    """What a name stands for.

    Attributes
    ----------
    name : str
    solver : str
        Key of ``core.depth.SOLVERS``, or `LEARNED`.
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
    tv_iterations : int
        The denoising's, at most.
    tv_precision : str
        What numbers the denoising is computed in. "int16" is the fastest; docs/numerics.md says how near.
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
    tv_iterations: int = ITERATIONS_MAX
    tv_precision: Precision = "float32"


DEFAULT = "balanced"
"""What a user gets who names none."""

# Eq. 1 serves the gate of the learned ones only.
_ACCURATE = Profile(
    "accurate", LEARNED, stride_px=4, window_pitches=2, tv_weight=0.0, gate_levels=16, gate_dark_levels=10
)
PROFILES: dict[str, Profile] = {
    p.name: p
    for p in (
        Profile(name="paper", solver="paper", stride_px=1, window_pitches=2, tv_weight=0.1, gate_levels=20),
        replace(_ACCURATE, name="fast", halved=True, cells=56),
        replace(_ACCURATE, name="balanced", halved=True),
        _ACCURATE,
    )
}

LADDER: tuple[str, ...] = tuple(name for name in ("accurate", "balanced", "fast") if name in PROFILES)
"""What `AUTO` steps between, the most accurate and dearest first."""
