"""What all solvers need and give."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from tacshade_edge.sensor.depth.sigma import SigmaModel
from tacshade_edge.types import F32, Bool, frozen

# Called with a stage's name at its end, so that a caller with a clock can time it: this package
# has none.
Mark = Callable[[str], None]
Features = list[F32]  # collects the features for a touch model, network by network


@frozen
class Depth:
    """A solver's answer on its grid.

    `height_mm`, float32 (rows, cols), is h, finite, not below 0, and undefined outside the disc;
    `contact`, bool (rows, cols) (None if only the heights show it), is False outside the disc;
    `saturated`: a cell left the range of the calibration; `repaired_px` counts values that were not
    finite, replaced by 0; `untrusted` cells, bool (rows, cols), undefined outside the disc, show
    something other than this sensor's skin. Log odds are float32: of contact (rows, cols), of
    untrusted (M, M), for fewer and wider cells.
    """

    height_mm: F32
    contact: Bool | None = None
    saturated: bool = False
    repaired_px: int = 0
    untrusted: Bool | None = None
    contact_logit: F32 | None = None
    untrusted_logit: F32 | None = None


@dataclass(frozen=True, slots=True)
class Network:
    """A network and the layout of its maps; N = cells / fold: each square of fold x fold cells
    becomes fold² channels. Its first layer is linear in its input, so `sense` maps the folded white
    of the reference and `learned.KNOWN` maps, (fold² + KNOWN, N, N), once to what they contribute
    to every frame, (channels, N, N). `run` maps the folded white of a frame, (fold², N, N), and
    that to the outputs, and appends features (D,) for a touch model to the list that it may get as
    third argument. Outputs of depth: (2 fold², N, N) depth and contact, and (1, M, M) log odds that
    a cell shows something other than the sensor's skin; of `shear`: (2, M, M).
    """

    fold: int
    cells: int  # along a side of its map
    sense: Callable[[F32], F32]
    run: Callable[..., Sequence[F32]]
    shear: Network | None = None
    sigma: SigmaModel | None = None
