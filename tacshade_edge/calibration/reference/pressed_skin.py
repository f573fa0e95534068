"""Does a reference show a load? A free skin is alike all around its centre and changes smoothly
outwards.
"""

from __future__ import annotations

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.reference import spacing
from tacshade_edge.sensor.geometry.disc import Grid, radius_squared
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.types import F32, Bool, Disc

# A patch is a load if it differs from its ring by this much (grey levels, and deviations of the
# disc, because a fine pattern makes every ring uneven), is this large (mm² on the nominal skin) and
# alone: a square lattice makes four such patches, a quarter turn apart.
# tools/studies/calibration.py measures what this finds, rightly and wrongly.
LOAD_GREY, LOAD_DEVIATIONS, LOAD_MM2 = 22.0, 3.5, 9.0
# A load in the middle is alike all around too, but bends the radial profile (second difference over
# two rings). The outer rings are left out: light at the rim brightens and bends them without a
# load.
RINGS, MIDDLE_RINGS, LOAD_BEND_GREY = 12, 10, 22.0


def load_finding(preprocessor: Preprocessor) -> CalibrationFinding | None:
    """What shows that the reference was taken under load; None if nothing does.

    The ratio of white shows objects that press between markers,
    the spacing of the markers wide ones.
    """
    g0, voting, geometry = (
        preprocessor.reference_g,
        preprocessor.voting,
        preprocessor.calibration.geometry,
    )
    grid, disc = preprocessor.grid, geometry.disc
    rho2 = radius_squared(grid, disc)
    residual = ring_residual(g0, rho2, voting)
    deviation = 1.4826 * float(np.median(np.abs(residual[voting]))) if voting.any() else 0.0
    threshold = max(LOAD_GREY, LOAD_DEVIATIONS * deviation)
    # The median of three, as one of them may fall on a second load.
    elsewhere = np.median(
        [quarter_turned(residual, grid, disc, turns) for turns in (1, 2, 3)], axis=0
    )
    lone = (np.abs(residual) > threshold) & (np.abs(residual - elsewhere) > threshold)
    area_mm2 = float(np.count_nonzero(lone)) * preprocessor.cell_mm2
    if area_mm2 >= LOAD_MM2 * skin_scale(geometry) ** 2:
        return finding(FindingCode.PRESSED_PATCH, area_mm2=area_mm2)
    if (bend := radial_bend(g0, rho2, voting)) > LOAD_BEND_GREY:
        return finding(FindingCode.PRESSED_CENTRE, bend_grey=bend)
    return spacing.widening_finding(preprocessor.calibration.reference_grey, geometry)


def ring_residual(g0: F32, rho2: F32, voting: Bool) -> F32:
    """g_0 less its median on each of 12 rings around the centre; 0 where `voting` is False."""
    rings = np.minimum((np.sqrt(rho2) * RINGS).astype(int), RINGS)
    residual: F32 = np.zeros_like(g0)
    for ring in range(RINGS + 1):
        cells = (rings == ring) & voting
        if cells.any():
            residual[cells] = g0[cells] - np.median(g0[cells])
    return residual


def quarter_turned(values: F32, grid: Grid, disc: Disc, turns: int) -> F32:
    """The values `turns` quarter turns around the disc's centre from each cell;
    beyond the grid, its border's.
    """
    rows = (grid.row0 + grid.step_px * np.arange(grid.rows))[:, None] - disc.row_c
    cols = (grid.col0 + grid.step_px * np.arange(grid.cols))[None, :] - disc.col_c
    for _ in range(turns):
        rows, cols = -cols, rows
    i = np.rint((rows + disc.row_c - grid.row0) / grid.step_px).astype(int)
    j = np.rint((cols + disc.col_c - grid.col0) / grid.step_px).astype(int)
    turned: F32 = values[np.clip(i, 0, grid.rows - 1), np.clip(j, 0, grid.cols - 1)]
    return turned


def radial_bend(g0: F32, rho2: F32, voting: Bool) -> float:
    """Greatest second difference, over two rings, of the radial profile of g_0 in the middle,
    from soft rings.
    """
    rho, profile = np.sqrt(rho2) * RINGS, []
    for ring in range(MIDDLE_RINGS):
        weight = np.maximum(1.5 - np.abs(rho - ring), 0) * voting
        if weight.any():
            profile.append(float((weight * g0).sum() / weight.sum()))
    mean = np.array(profile)
    return float(np.abs(mean[:-4] - 2 * mean[2:-2] + mean[4:]).max(initial=0.0))
