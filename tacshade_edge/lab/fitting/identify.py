"""Find the print of a sensor in its reference: where its pins are, how long and how thick they are,
its markers.

From where the pins seem to be (`lattice`), lengths, radii and the lattice are fitted to the white
of the cells as the networks receive it (Levenberg and Marquardt). Pins near the rim are seen from
the side, so how far a tip lies from its base gives the length, which statistics of the picture
cannot distinguish from the radius of the base. The picture's blur is fitted as well, because a
blurred pin shows less black than a sharp one, as a thinner pin does.

The white of cells is a staircase, on which differences lead astray, and pins that stand a little
beside their place look blurred. So each pin is registered by itself (Lucas and Kanade, 1981), and
sizes and blur are then those of the minimum of a quadratic through many random ones (a response
surface; Box and Wilson, 1951).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType

import cv2
import numpy as np
from scipy.optimize import least_squares

from tacshade_edge.lab.fitting.lattice import (
    NOMINAL_PITCHES,
    Lattice,
    Tips,
    find_lattice,
    find_tips,
)
from tacshade_edge.lab.fitting.prints import (
    BLURS_PX,
    DEVIATIONS,
    KINDS,
    PARAMETERS,
    TRIANGLES,
    WHITE_TIP_DEVIATIONS,
    Found,
    Kind,
    Problem,
    WhiteMap,
    base_model,
    lattice_px,
    seen_light,
    sensor_with,
    sharpness,
    tips_px,
)
from tacshade_edge.lab.simulator.render import reach_mm
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import disc_mask
from tacshade_edge.types import F32, F64, Bool, Calibration

LOWEST, HIGHEST = np.array((0.2, 0.08, 0.08, 0.26)), np.array((2.4, 0.46, 0.46, 0.60))
# Of differences: wide enough to cross several steps of the staircase that the white of cells is.
STEPS = np.array((0.06, 0.012, 0.012, 0.015))
SIZES, MARKERS = tuple(product((1.2, 1.6, 2.0), (0.36, 0.28), (0.28, 0.2))), (0.35, 0.42, 0.5)
"""Sizes from which a fit may start: those that explain the reference best are followed, so that it
does not end in a minimum of another print.
"""
MERGED, APART = 0.5, 0.28
"""Radii of markers in triangles that merge, so that nothing shows their size, and of those that
hardly do. With a free size, fits of merged ones stop in minima of other prints.
"""
STARTS, FINISHED = 2, 3
MARKER = 3
"""The place of the markers' size among the values."""
BLUR_STEP_PX = 0.08
BOXES = np.array(((0.2, 0.025, 0.035, 0.12), (0.15, 0.018, 0.025, 0.08), (0.1, 0.012, 0.018, 0.06)))
"""Half the widths of the boxes in which sizes and blur are drawn (`quadratic`): lengths, tips,
bases, blur. Where pins stand is known better in the later ones.
"""
LEAST, MOST = np.array((*LOWEST[:3], BLURS_PX[0])), np.array((*HIGHEST[:3], BLURS_PX[1]))
# Four values make a quadratic of 15 coefficients; four times as many draws average the staircase.
DRAWN = 60
ALIKE_CELLS = 10
"""Neighbouring cells err alike: this many count as one in the covariance."""
REGISTERED_CELLS, REGISTERED_PART, LEAST_SLOPE = 0.7, 0.88, 1e-3
"""Smoothing of the white against which pins are registered, the part of the disc's radius within
which they are, and the slope squared of white that is flat.
"""
FLATTEST, FARTHEST, LEAST_PINS = 0.02, 1.2, 12
"""The least curvature of a quadratic, as a part of its greatest, and the farthest step,
in halves of a box.
"""
Begun = tuple[tuple[F64, float, F64], Problem]
"""The values, their cost, the last Jacobian; and what was solved."""


def identify(
    calibration: Calibration, stated: Mapping[str, float] = MappingProxyType({})
) -> list[Found]:
    """Fit the likeliest kinds of print to the reference; the best first, none if no pins are seen.

    `stated` holds sizes in mm that are known: ``pitch_mm``, and `PARAMETERS` in mm.
    """
    seen = _Seen.of(calibration, stated)
    begun: list[Begun] = []
    for kind in KINDS:
        begun += _begun(seen, kind)
    # Every kind begins, few are finished: to refine one takes `DRAWN` pictures for each of `BOXES`.
    begun.sort(key=lambda each: each[0][1])
    # As a part of what a flat grey picture would leave, so that prints of any contrast compare.
    spread = float(seen.reference[seen.white.inside].std())
    cells = int(np.count_nonzero(seen.white.inside))
    made = []
    for (values, _, _), problem in begun[:FINISHED]:
        free = [k for k in (0, 1, 2, len(values) - 1) if k not in seen.known]
        values, covariance = refined(problem, values, free)
        unexplained = problem.against(0.0)(values)
        residual = math.sqrt(float(unexplained @ unexplained) / cells) / spread
        deviations = WHITE_TIP_DEVIATIONS if problem.kind.white_tips else DEVIATIONS
        made.append(
            Found(
                problem.kind,
                values,
                covariance,
                residual,
                problem.tips,
                seen.base,
                seen.light,
                deviations,
            )
        )
    return sorted(made, key=lambda each: each.residual)


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What a reference shows before a kind of print is fitted.

    `known`: values that the user stated, by their places. `dark`: where dark pins form a lattice.
    `tips`: of white pins.
    """

    calibration: Calibration
    base: SensorModel
    known: dict[int, float]
    white: WhiteMap
    reference: F32
    light: F32
    dark: Lattice | None
    tips: F64
    middle: Bool
    sharp: float

    @classmethod
    def of(cls, calibration: Calibration, stated: Mapping[str, float]) -> _Seen:
        """Look at a sensor's reference."""
        base, white = base_model(calibration), WhiteMap(calibration)
        base = replace(base, pitch_mm=stated.get("pitch_mm", base.pitch_mm))
        sizes = [stated.get(name.replace("_pitches", "_mm")) for name in PARAMETERS]
        light, darkness = seen_light(calibration)
        base = replace(
            base, pin_reflectance=min(darkness, 0.5), skin_reflectance=min(1.6 * darkness, 0.6)
        )
        # With a nominal length: it moves all tips outwards or inwards, not from each other.
        pins = find_tips(calibration, False, NOMINAL_PITCHES)
        disc = calibration.geometry.disc
        size = calibration.image_height_px, calibration.image_width_px
        middle = disc_mask(*size, replace(disc, radius_px=0.9 * disc.radius_px))
        return cls(
            calibration,
            base,
            {k: size / base.pitch_mm for k, size in enumerate(sizes) if size is not None},
            white,
            white.reference(),
            light,
            find_lattice(calibration, pins, NOMINAL_PITCHES),
            find_tips(calibration, True, 0.7),
            middle,
            sharpness(calibration.reference_grey, middle),
        )

    def problem(self, kind: Kind, tips: Tips | None) -> Problem:
        """The problem of a kind of print."""
        pitch_px = self.calibration.pitch_px
        return Problem(
            self.white,
            self.reference,
            pitch_px,
            self.sharp,
            self.middle,
            self.light,
            self.base,
            kind,
            tips,
        )


def _begun(seen: _Seen, kind: Kind) -> list[Begun]:
    """Fit a kind of print from several starts; none if the reference does not show such pins."""
    merge = kind.marker_parts == TRIANGLES and MARKER not in seen.known
    if kind.white_tips and len(seen.tips) > LEAST_PINS:
        tips, place = Tips(seen.tips), np.zeros(0)
        lengths, others, first = [0.6], (0.25, 0.25, 0.4), (0, 1, 2)
    elif seen.dark is not None and not kind.white_tips:
        tips, place = None, seen.dark.values
        marker = MERGED if merge else 0.45
        lengths, others, first = [1.1, 1.6, 2.0], (0.35, 0.28, marker), (0, 1, MARKER)
    else:
        return []
    blur_px = max(0.7, seen.calibration.geometry.disc.radius_px / 300)
    starts = [np.array((length, *others, *place, blur_px)) for length in lengths]
    for start in starts:
        start[list(seen.known)] = list(seen.known.values())
    every = [k for k in (*first, *range(4, len(starts[0]))) if k not in seen.known]
    free = [k for k in every if not merge or k != MARKER]
    problem, limits = seen.problem(kind, tips), _limits(seen.base, len(place))
    # Smoothed over two cells first, so that pins that are off by half a pitch still find their
    # place.
    rough, finer = problem.against(2.0), problem.against(1.0)
    starts = [levenberg(rough, each, free, *limits, 4)[0] for each in starts]
    if not problem.tips:
        markers = (MERGED,) if merge else MARKERS
        starts += [
            _resized(each, (*sizes, marker), seen.known)
            for each in starts
            for sizes in SIZES
            for marker in markers
        ]
    starts.sort(key=lambda each: float(np.square(finer(each)).sum()))
    fits = [levenberg(finer, each, free, *limits, 4) for each in starts[:STARTS]]
    fit = min(fits, key=lambda fit: fit[1])
    begun = [(fit, problem)]
    if merge:
        apart = fit[0].copy()
        # Markers that merge or hardly do: between the two, fits stop in minima of other prints.
        apart[MARKER] = APART
        begun.append((levenberg(finer, apart, every, *limits, 4), problem))
    return begun


def _limits(base: SensorModel, place: int) -> tuple[F64, F64, F64]:
    """Steps, least and greatest values of sizes, the `place` values of a lattice, and blur."""
    e = 0.02 * base.pitch_mm
    reach = np.array((*[99.0] * 6, 0.3))[:place]
    lattice = (e, e, e / 8, e / 8, e / 8, e / 8, 0.004)[:place]
    return (
        np.array((*STEPS, *lattice, BLUR_STEP_PX)),
        np.array((*LOWEST, *-reach, BLURS_PX[0])),
        np.array((*HIGHEST, *reach, BLURS_PX[1])),
    )


def refined(problem: Problem, values: F64, free: Sequence[int]) -> tuple[F64, F64]:
    """Find where the pins stand, then the values `free`, and these again with each pin where it
    appears; and their covariance.
    """
    moved_px: F64 | float = 0.0
    covariance = np.zeros((len(values), len(values)))
    for k, box in enumerate(BOXES):
        for _ in range(2):
            moved_px = registered(problem, values, moved_px)
            # Only at first: later the lattice is known, and what is left is the error of each pin.
            if k == 0 and problem.tips is None:
                values, moved_px = with_lattice(problem, values, moved_px), 0.0
        values, covariance = quadratic(problem.against(0.5, moved_px), values, free, box, k)
    if problem.tips is None:
        values = with_lattice(problem, values, registered(problem, values, 0.0))
    return values, covariance


def registered(problem: Problem, values: F64, moved_px: F64 | float) -> F64:
    """By how much each tip appears beside its place, (N, 2) px: a step from `moved_px`."""
    model, layout = sensor_with(problem.base, problem.kind, problem.tips, values)
    disc, grid = model.geometry.disc, disc_map.map_grid(model.geometry.disc)
    seen, drawn = (
        cv2.GaussianBlur(cells, (0, 0), REGISTERED_CELLS)
        for cells in (problem.reference, problem.white.of(problem.picture(values, moved_px)))
    )
    (down, across), off = np.gradient(drawn), seen - drawn
    px = tips_px(model, layout) + moved_px
    cells = ((px - (grid.col0, grid.row0)) / grid.step_px).astype(np.float32)
    # Not farther than half a pitch: beyond it lies the next pin.
    sigma_cells = 0.45 * problem.pitch_px / grid.step_px

    def beside(product: F32) -> F64:
        spread = cv2.GaussianBlur(product * problem.white.inside, (0, 0), sigma_cells)
        return np.asarray(
            cv2.remap(spread, cells[:, :1], cells[:, 1:], cv2.INTER_LINEAR), np.float64
        )

    xx, xy, yy = (
        beside(across * across) + LEAST_SLOPE,
        beside(across * down),
        beside(down * down) + LEAST_SLOPE,
    )
    x, y = beside(across * off), beside(down * off)
    step_px = grid.step_px * np.hstack((xy * y - yy * x, xy * x - xx * y)) / (xx * yy - xy * xy)
    step_px[np.hypot(*(px - (disc.col_c, disc.row_c)).T) > REGISTERED_PART * disc.radius_px] = 0
    # A cell at a time: the linearisation holds no further.
    return np.asarray(moved_px + np.clip(step_px, -grid.step_px, grid.step_px))


def with_lattice(problem: Problem, values: F64, moved_px: F64) -> F64:
    """The values with the lattice that fits the tips best where they appear."""
    model, lattice = sensor_with(problem.base, problem.kind, None, values)
    assert isinstance(lattice, Lattice)
    steps, near = (
        lattice.steps(model.skin_radius_mm, 1.05 * reach_mm(model)),
        (moved_px != 0).any(axis=1),
    )
    if np.count_nonzero(near) < LEAST_PINS:
        return values
    steps, target = steps[near], (tips_px(model, lattice) + moved_px)[near]
    fit = least_squares(
        lambda each: (lattice_px(model, Lattice(each), steps) - target).ravel(),
        lattice.values,
        # A few pins are hidden by glare or glued askew, and must not bend the lattice.
        loss="cauchy",
    )
    return np.concatenate((values[:4], fit.x, values[-1:]))


def quadratic(
    residual: Callable[[F64], F64], values: F64, free: Sequence[int], box: F64, seed: int
) -> tuple[F64, F64]:
    """The values at the minimum of the quadratic through the costs of random values in a box,
    and their covariance.
    """
    at, n = list(free), len(free)
    columns_of = [min(k, 3) for k in at]
    half, low, high = box[columns_of], LEAST[columns_of], MOST[columns_of]
    tried = np.tile(values, (DRAWN, 1))
    tried[:, at] = np.clip(
        values[at] + np.random.default_rng(seed).uniform(-1, 1, (DRAWN, n)) * half, low, high
    )
    x = (tried[:, at] - values[at]) / half
    residuals = [residual(each) for each in tried]
    costs = np.array([float(r @ r) for r in residuals])
    pairs = [(i, j) for i in range(n) for j in range(i, n)]
    columns = np.column_stack((np.ones(DRAWN), x, *(x[:, i] * x[:, j] for i, j in pairs)))
    c = np.linalg.lstsq(columns, costs, rcond=None)[0]
    hessian = np.zeros((n, n))
    for (i, j), each in zip(pairs, c[n + 1 :], strict=True):
        hessian[i, j] += each
        hessian[j, i] += each
    curvature, axes = np.linalg.eigh(hessian)
    # Of a saddle, which noise makes of a flat valley, the minimum would lie anywhere.
    curvature = np.maximum(curvature, FLATTEST * curvature.max())
    inverse = axes / curvature @ axes.T
    step = -inverse @ c[1 : n + 1]
    made, covariance = values.copy(), np.zeros((len(values), len(values)))
    made[at] = np.clip(made[at] + half * step / max(np.abs(step).max() / FARTHEST, 1), low, high)
    # What is left at the minimum is the noise: no other estimate of it is at hand.
    noise = ALIKE_CELLS * costs.min() / len(residuals[0])
    covariance[np.ix_(at, at)] = 2 * noise * inverse * np.outer(half, half)
    return made, covariance


def _resized(values: F64, sizes: Sequence[float], known: Mapping[int, float]) -> F64:
    """The values with other `PARAMETERS`, but for those that are known."""
    made = np.append(sizes, values[4:])
    made[list(known)] = list(known.values())
    return made


def levenberg(
    residual: Callable[[F64], F64],
    start: F64,
    free: list[int],
    steps: F64,
    low: F64,
    high: F64,
    rounds: int,
) -> tuple[F64, float, F64]:
    """Least squares over the `free` values with differences of `steps`:
    the values, their cost, the last Jacobian.

    SciPy's methods choose steps for smooth functions; the white of cells is a staircase.
    """
    values, damping = start.copy(), 0.03
    r = residual(values)
    cost = float(r @ r)
    jacobian = np.zeros((len(r), len(free)))
    for _ in range(rounds):
        for column, k in enumerate(free):
            moved, step = values.copy(), steps[k] if values[k] + steps[k] < high[k] else -steps[k]
            moved[k] += step
            jacobian[:, column] = (residual(moved) - r) / step
        h, g, before = jacobian.T @ jacobian, jacobian.T @ r, cost
        for _ in range(4):
            # Scaled by the diagonal (Marquardt 1963): values have different units.
            delta = np.linalg.solve(h + damping * np.diag(np.diag(h) + 1e-9), -g)
            trial = values.copy()
            trial[free] = np.clip(values[free] + delta, low[free], high[free])
            there = residual(trial)
            if (now := float(there @ there)) < cost:
                values, r, cost, damping = trial, there, now, damping / 5
                break
            damping *= 6
        if before - cost < 1e-3 * before:
            break
    return values, cost, jacobian
