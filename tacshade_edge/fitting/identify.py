"""Find the print of a sensor in its reference: where its pins are, how long and how thick they are, its markers.

From where the pins seem to be (`pins`), lengths, radii and the lattice are fitted to the white of the cells as the
networks receive it (Levenberg and Marquardt). Pins near the rim are seen from the side, so how far a tip lies from its
base gives the length, which statistics of the picture cannot distinguish from the radius of the base. The picture's
blur is fitted as well, because a blurred pin shows less black than a sharp one, as a thinner pin does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Any

import cv2
import numpy as np

from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.geometry.disc import Window, disc_mask
from tacshade_edge.core.image.white import CellMeans, Integrator, binarise
from tacshade_edge.fitting import compiled
from tacshade_edge.fitting.lattice import (
    NOMINAL_PITCHES,
    Lattice,
    Layout,
    Tips,
    equal_area,
    find_lattice,
    find_tips,
    pitch_mm_of,
    sphere_points,
)
from tacshade_edge.simulator.model import MAX_VISIBLE_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.simulator.render import (
    CAP,
    FRUSTUM,
    PinProfile,
    Print,
    Renderer,
    equal_area_to_direction,
    print_at,
    project,
)
from tacshade_edge.simulator.skin import Skin, undeformed
from tacshade_edge.types import F32, F64, U8, Bool, Calibration

PARAMETERS = ("pin_length_pitches", "pin_tip_radius_pitches", "pin_base_radius_pitches", "marker_radius_pitches")
DEVIATIONS = np.array((0.10, 0.015, 0.02, 0.02))
WHITE_TIP_DEVIATIONS = np.array((0.35, 0.015, 0.03, 0.02))
"""Standard deviations of `PARAMETERS` by which a fit is off besides its own doubt. Only the size of their tips shows
how long white pins are."""
LOWEST, HIGHEST = np.array((0.2, 0.08, 0.08, 0.26)), np.array((2.4, 0.46, 0.46, 0.60))
STEPS = np.array((0.06, 0.012, 0.012, 0.015))
SIZES = tuple(product((1.2, 1.6, 2.0), (0.36, 0.28), (0.28, 0.2), (0.35, 0.42, 0.5)))
"""Sizes from which a fit may start: those that explain the reference best are followed, so that it does not end in a
minimum of another print."""
STARTS, FINISHED = 2, 3
SHARPER = (1.0, 0.5, 0.0)
"""Smoothing of the white in the steps of a fit, in cells: a smooth map has one minimum, a sharp one the best."""
ALIKE_CELLS = 10
"""Neighbouring cells err alike: this many count as one in the covariance."""
BLURS_PX, BLUR_STEP_PX = (0.2, 3.0), 0.08
SHARP_PX, SHARPNESS_WEIGHT = 0.7, 200.0
"""`sharpness` compares gradients with those after a blur of this standard deviation. Its weight in a fit lets a
difference of one in a hundred count as much as a change of all cells by 0.02."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A way to make a print: white tips, or dark pins beside markers in the lattice's triangles or cells."""

    white_tips: bool
    marker_parts: tuple[tuple[float, float], ...]
    profile: PinProfile

    @property
    def name(self) -> str:
        """For reports."""
        what = "white tips" if self.white_tips else f"dark pins, {len(self.marker_parts)} markers a cell"
        return what + (", caps" if self.profile.rings else "")


TRIANGLES, CELLS = ((1 / 3, 1 / 3), (2 / 3, 2 / 3)), ((0.5, 0.5),)
KINDS = (
    Kind(False, TRIANGLES, FRUSTUM),
    Kind(False, CELLS, FRUSTUM),
    Kind(False, TRIANGLES, CAP),
    Kind(False, CELLS, CAP),
    Kind(True, (), FRUSTUM),
)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """A print that was fitted to a reference. `values` (float64 (P,)): `PARAMETERS`, the lattice's values if there is
    one, then the blur in px. `covariance`: float64 (P, P). `residual`: RMS of the white that the print leaves
    unexplained, over that of the reference's white.
    """

    kind: Kind
    values: F64
    covariance: F64
    residual: float
    tips: Tips | None
    base: SensorModel
    light: F32

    def at(self, values: F64) -> tuple[SensorModel, Layout]:
        """The sensor with these values, and where its pins are."""
        return sensor_with(self.base, self.kind, self.tips, values)

    def cloud(self) -> F64:
        """Covariance of the values that the reference leaves possible, (P, P): the fit's, and errors of the model."""
        model = np.zeros(len(self.values))
        model[:4] = WHITE_TIP_DEVIATIONS if self.kind.white_tips else DEVIATIONS
        return np.asarray(4 * self.covariance + np.diag(model**2))


def seen_light(calibration: Calibration) -> tuple[F32, float]:
    """Grey level of white features over the image, float32 (H, W), and that of dark ones as a part of it."""
    grey, disc = calibration.reference_grey, calibration.geometry.disc
    mask = disc_mask(grey.shape[0], grey.shape[1], disc)
    side = 2 * round(0.7 * calibration.pitch_px) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    fine = cv2.GaussianBlur(np.where(mask, grey, np.uint8(0)), (0, 0), 1.0)
    white = cv2.dilate(fine, kernel).astype(np.float32)
    dark = cv2.erode(np.where(mask, grey, np.uint8(255)), kernel).astype(np.float32)
    weight = mask.astype(np.float32)
    sigma = 1.5 * calibration.pitch_px
    white = cv2.GaussianBlur(white * weight, (0, 0), sigma) / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)
    middle = (
        np.hypot(*(np.indices(grey.shape) - np.array((disc.row_c, disc.col_c))[:, None, None])) < 0.8 * disc.radius_px
    )
    return np.maximum(white, 1).astype(np.float32), float(np.median(dark[middle] / np.maximum(white[middle], 1)))


def base_model(calibration: Calibration) -> SensorModel:
    """A sensor with the calibrated geometry; its print comes later."""
    geometry, disc = calibration.geometry, calibration.geometry.disc
    return replace(
        SensorModel(),
        skin_radius_mm=geometry.skin_radius_mm,
        camera_distance_mm=geometry.camera_distance_mm,
        visible_half_angle_deg=min(geometry.visible_half_angle_deg, MAX_VISIBLE_HALF_ANGLE_DEG),
        image_height_px=calibration.image_height_px,
        image_width_px=calibration.image_width_px,
        row_c=disc.row_c,
        col_c=disc.col_c,
        disc_radius_px=disc.radius_px,
        pitch_mm=pitch_mm_of(calibration),
        colour_bgr=(1.0, 1.0, 1.0),
        specular_spots=0,
        surround="dark",
        position_tolerance_mm=0.0,
        size_tolerance=0.0,
    )


def with_print(model: SensorModel, kind: Kind, values: F64) -> SensorModel:
    """The sensor with these `PARAMETERS`."""
    sizes: dict[str, Any] = dict(zip(PARAMETERS, map(float, values), strict=True))
    model = replace(model, **sizes)
    if kind.white_tips:
        return replace(model, skin_reflectance=0.1, marker_reflectance=0.1, pin_reflectance=0.09, pin_tip_reflectance=1)
    return replace(model, marker_reflectance=1, pin_tip_reflectance=model.pin_reflectance)


def sensor_with(base: SensorModel, kind: Kind, tips: Tips | None, values: F64) -> tuple[SensorModel, Layout]:
    """The sensor with the values of a fit, and where its pins are."""
    model = replace(with_print(base, kind, values[:4]), blur_px=float(values[-1]))
    return model, tips or Lattice(values[4:-1])


def print_of(model: SensorModel, kind: Kind, layout: Layout) -> Print:
    """The print with the model's pins and markers in these places."""
    r = model.skin_radius_mm
    if isinstance(layout, Tips):
        at = sphere_points(model.geometry, layout.px, r - model.pin_length_pitches * model.pitch_mm)
        return print_at(model, equal_area(at, r), np.zeros((0, 2)))
    nominal, actual = (r - length * model.pitch_mm for length in (NOMINAL_PITCHES, model.pin_length_pitches))
    limit = 2 * r * math.sin(math.radians(model.visible_half_angle_deg + 6) / 2)

    def under_tips(parts: Sequence[tuple[float, float]]) -> F64:
        tips = equal_area_to_direction(layout.points(r, 1.05 * limit, parts), r) * nominal
        return equal_area(sphere_points(model.geometry, project(model.geometry, tips), actual), r)

    return print_at(model, under_tips(((0.0, 0.0),)), under_tips(kind.marker_parts))


class WhiteMap:
    """The white of the cells of a sensor's pictures."""

    def __init__(self, calibration: Calibration) -> None:
        disc = calibration.geometry.disc
        self._calibration = calibration
        self._mask = disc_mask(calibration.image_height_px, calibration.image_width_px, disc).astype(np.uint8)
        self._integrator = Integrator(Window(0, 0, *self._mask.shape), 0)
        self._cells = CellMeans(self._integrator, disc_map.map_grid(disc))
        axis = (np.arange(disc_map.CELLS) + 0.5 - disc_map.CELLS / 2) * (2 * disc_map.REACH / disc_map.CELLS)
        self.inside = np.hypot(axis[:, None], axis[None, :]) < 0.93

    def of(self, grey: U8) -> F32:
        """White of a picture, float32 (cells, cells), 0 to 1."""
        c = self._calibration
        return self._cells.means(self._integrator.integrate(binarise(grey, self._mask, c.binarisation, c.pitch_px)))

    def reference(self) -> F32:
        """White of the reference."""
        return self._cells.means(self._integrator.integrate(self._calibration.reference_white)) / np.float32(255)


class TwinRenderer(Renderer):
    """Draws a print under the light of the reference, with compiled motion of the skin."""

    def __init__(self, model: SensorModel, kind: Kind, marks: Print, light: F32) -> None:
        super().__init__(model, marks, kind.profile)
        self._light = light

    def _carried(self, skin: Skin, chart_mm: F64, friction: float) -> tuple[F64, F64]:
        return compiled.carried(skin, chart_mm, friction)


def sharpness(grey: U8, mask: Bool) -> float:
    """How much steeper a picture is than after a slight blur, as a logarithm; it does not depend on the light."""

    def steep(image: F32) -> float:
        by_axis = (cv2.Sobel(image, cv2.CV_32F, *axis, scale=1 / 8)[mask] for axis in ((1, 0), (0, 1)))
        return sum(float(np.square(each).sum()) for each in by_axis)

    image = grey.astype(np.float32)
    return math.log(max(steep(image), 1e-6) / max(steep(cv2.GaussianBlur(image, (0, 0), SHARP_PX)), 1e-6))


def at_rest(model: SensorModel, kind: Kind, marks: Print, light: F32) -> U8:
    """A noiseless picture of the unloaded skin."""
    drawn = TwinRenderer(model, kind, marks, light).draw(undeformed(model.skin_radius_mm))
    return np.asarray(np.clip(drawn + 0.5, 0, 255), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What a kind of print is fitted to."""

    white: WhiteMap
    reference: F32
    sharp: float
    middle: Bool
    light: F32
    base: SensorModel
    kind: Kind
    tips: Tips | None

    def against(self, sigma_cells: float) -> Callable[[F64], F64]:
        """The white that values leave unexplained, smoothed over cells, then the sharpness."""

        def soft(cells: F32) -> F64:
            cells = cv2.GaussianBlur(cells, (0, 0), sigma_cells) if sigma_cells else cells
            return np.asarray(cells[self.white.inside], np.float64)

        target = soft(self.reference)

        def residual(values: F64) -> F64:
            model, layout = sensor_with(self.base, self.kind, self.tips, values)
            picture = at_rest(model, self.kind, print_of(model, self.kind, layout), self.light)
            blurred = SHARPNESS_WEIGHT * (sharpness(picture, self.middle) - self.sharp)
            return np.append(soft(self.white.of(picture)) - target, blurred)

        return residual


def identify(calibration: Calibration, stated: Mapping[str, float] = MappingProxyType({})) -> list[Found]:
    """Fit the likeliest kinds of print to the reference; the best first, none if no pins are seen.

    `stated` holds sizes in mm that are known: ``pitch_mm``, and `PARAMETERS` in mm.
    """
    base, white = base_model(calibration), WhiteMap(calibration)
    base = replace(base, pitch_mm=stated.get("pitch_mm", base.pitch_mm))
    sizes = [stated.get(name.replace("_pitches", "_mm")) for name in PARAMETERS]
    known = {k: size / base.pitch_mm for k, size in enumerate(sizes) if size is not None}
    reference = white.reference()
    light, darkness = seen_light(calibration)
    base = replace(base, pin_reflectance=min(darkness, 0.5), skin_reflectance=min(1.6 * darkness, 0.6))
    dark, tips = find_tips(calibration, False, NOMINAL_PITCHES), find_tips(calibration, True, 0.7)
    lattice = find_lattice(calibration, dark, NOMINAL_PITCHES)
    disc = calibration.geometry.disc
    size = calibration.image_height_px, calibration.image_width_px
    middle = disc_mask(*size, replace(disc, radius_px=0.9 * disc.radius_px))
    sharp, blur_px = sharpness(calibration.reference_grey, middle), max(0.7, disc.radius_px / 300)
    e = 0.02 * base.pitch_mm
    begun = []
    for kind in KINDS:
        if kind.white_tips and len(tips) > 12:
            seen_at, place = Tips(tips), np.zeros(0)
            lengths, others, first = [0.6], (0.25, 0.25, 0.4), (0, 1, 2)
        elif lattice is not None and not kind.white_tips:
            seen_at, place = None, lattice.values
            lengths, others, first = [1.1, 1.6, 2.0], (0.35, 0.28, 0.45), (0, 1, 3)
        else:
            continue
        problem = Problem(white, reference, sharp, middle, light, base, kind, seen_at)
        starts = [np.array((length, *others, *place, blur_px)) for length in lengths]
        for start in starts:
            start[list(known)] = list(known.values())
        reach = np.array((*[99.0] * 6, 0.3))[: len(place)]
        limits = (
            np.array((*STEPS, *(e, e, e / 8, e / 8, e / 8, e / 8, 0.004)[: len(place)], BLUR_STEP_PX)),
            np.array((*LOWEST, *-reach, BLURS_PX[0])),
            np.array((*HIGHEST, *reach, BLURS_PX[1])),
        )
        free = [k for k in (*first, *range(4, len(starts[0]))) if k not in known]
        rough, finer = problem.against(2.0), problem.against(1.0)
        starts = [levenberg(rough, each, free, *limits, 4)[0] for each in starts]
        if not problem.tips:
            starts += [_resized(each, sizes, known) for each in starts for sizes in SIZES]
        starts.sort(key=lambda each: float(np.square(finer(each)).sum()))
        fits = [levenberg(finer, each, free, *limits, 4) for each in starts[:STARTS]]
        begun.append((min(fits, key=lambda fit: fit[1]), problem, limits))
    begun.sort(key=lambda each: each[0][1])
    spread, cells = float(reference[white.inside].std()), int(np.count_nonzero(white.inside))
    made = []
    for (values, _, _), problem, limits in begun[:FINISHED]:
        n = len(values)
        free = [k for k in (0, 1, 2, *range(4 if problem.tips else 3, n)) if k not in known]
        for sigma_cells in SHARPER:
            values, cost, jacobian = levenberg(problem.against(sigma_cells), values, free, *limits, 7)
        seen = np.abs(jacobian).sum(axis=0) > 1e-9
        covariance = np.zeros((n, n))
        at = np.array(free)[seen]
        information = jacobian[:, seen].T @ jacobian[:, seen] * (cells / cost / ALIKE_CELLS)
        covariance[np.ix_(at, at)] = np.linalg.pinv(information)
        made.append(
            Found(problem.kind, values, covariance, math.sqrt(cost / cells) / spread, problem.tips, base, light)
        )
    return sorted(made, key=lambda each: each.residual)


def _resized(values: F64, sizes: Sequence[float], known: Mapping[int, float]) -> F64:
    """The values with other `PARAMETERS`, but for those that are known."""
    made = np.append(sizes, values[4:])
    made[list(known)] = list(known.values())
    return made


def levenberg(
    residual: Callable[[F64], F64], start: F64, free: list[int], steps: F64, low: F64, high: F64, rounds: int
) -> tuple[F64, float, F64]:
    """Least squares over the `free` values with differences of `steps`: the values, their cost, the last Jacobian.

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
