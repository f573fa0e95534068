"""Kinds of print, and what a sensor that has one looks like at rest."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from tacshade_edge.lab.fitting import compiled
from tacshade_edge.lab.fitting.lattice import (
    NOMINAL_PITCHES,
    Lattice,
    Layout,
    Tips,
    equal_area,
    pitch_mm_of,
    sphere_points,
)
from tacshade_edge.lab.simulator.render import (
    CAP,
    FRUSTUM,
    PinProfile,
    Print,
    Renderer,
    equal_area_to_direction,
    print_at,
    project,
    reach_mm,
)
from tacshade_edge.lab.simulator.sensor_model import MAX_VISIBLE_HALF_ANGLE_DEG, SensorModel
from tacshade_edge.lab.simulator.skin import Skin, undeformed
from tacshade_edge.sensor.geometry import disc_map
from tacshade_edge.sensor.geometry.disc import Window, disc_mask
from tacshade_edge.sensor.image.white import CellMeans, Integrator, binarise
from tacshade_edge.types import F32, F64, U8, Bool, Calibration

PARAMETERS = (
    "pin_length_pitches",
    "pin_tip_radius_pitches",
    "pin_base_radius_pitches",
    "marker_radius_pitches",
)
DEVIATIONS = np.array((0.05, 0.007, 0.012, 0.02))
WHITE_TIP_DEVIATIONS = np.array((0.35, 0.015, 0.03, 0.02))
"""Standard deviations of `PARAMETERS` by which a fit is off besides its own doubt.

Only the size of their tips shows how long white pins are.
"""
BLURS_PX = (0.2, 3.0)
SHARP_PX, SHARPNESS_WEIGHT = 0.7, 200.0
"""`sharpness` compares gradients with those after a blur of this standard deviation.

Its weight in a fit lets a difference of one in a hundred count as much as a change of all cells
by 0.02.
"""


@dataclass(frozen=True, slots=True)
class Kind:
    """A way to make a print: white tips, or dark pins beside markers in the lattice's triangles or
    cells; or `patches` of the sensor's own picture around white tips (`lab.fitting.patches`).
    """

    white_tips: bool
    marker_parts: tuple[tuple[float, float], ...]
    profile: PinProfile
    patches: bool = False

    @property
    def name(self) -> str:
        """For reports."""
        if self.patches:
            return "tips from the sensor's own picture"
        what = (
            "white tips"
            if self.white_tips
            else f"dark pins, {len(self.marker_parts)} markers a cell"
        )
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
    """A print that was fitted to a reference.

    `values` (float64 (P,)): `PARAMETERS`, the lattice's values if there is one, then the blur in
    px. `covariance`: float64 (P, P). `residual`: RMS of the white that the print leaves
    unexplained, over that of the reference's white. `light`, float32 (H, W): grey level of white
    features, or, for a print of patches, the reference inside the disc. `around`: the reference
    outside it, for patches. `deviations` (float64 (4,)): standard deviations of `PARAMETERS` by
    which a fit is off besides its own doubt.
    """

    kind: Kind
    values: F64
    covariance: F64
    residual: float
    tips: Tips | None
    base: SensorModel
    light: F32
    deviations: F64
    around: F32 | None = None

    def at(self, values: F64) -> tuple[SensorModel, Layout]:
        """The sensor with these values, and where its pins are."""
        return sensor_with(self.base, self.kind, self.tips, values)

    def cloud(self) -> F64:
        """Covariance of the values that the reference leaves possible, (P, P):
        the fit's, and errors of the model.
        """
        model = np.zeros(len(self.values))
        model[: len(PARAMETERS)] = self.deviations
        return np.asarray(4 * self.covariance + np.diag(model**2))


def seen_light(calibration: Calibration) -> tuple[F32, float]:
    """Grey level of white features over the image, float32 (H, W),
    and that of dark ones as a part of it.
    """
    grey, disc = calibration.reference_grey, calibration.geometry.disc
    mask = disc_mask(grey.shape[0], grey.shape[1], disc)
    side = 2 * round(0.7 * calibration.pitch_px) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    fine = cv2.GaussianBlur(np.where(mask, grey, np.uint8(0)), (0, 0), 1.0)
    white = cv2.dilate(fine, kernel).astype(np.float32)
    dark = cv2.erode(np.where(mask, grey, np.uint8(255)), kernel).astype(np.float32)
    weight = mask.astype(np.float32)
    sigma = 1.5 * calibration.pitch_px
    white = cv2.GaussianBlur(white * weight, (0, 0), sigma) / np.maximum(
        cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3
    )
    middle = (
        np.hypot(*(np.indices(grey.shape) - np.array((disc.row_c, disc.col_c))[:, None, None]))
        < 0.8 * disc.radius_px
    )
    return np.maximum(white, 1).astype(np.float32), float(
        np.median(dark[middle] / np.maximum(white[middle], 1))
    )


def base_model(calibration: Calibration) -> SensorModel:
    """A sensor with the calibrated geometry; its print comes later."""
    geometry, disc = calibration.geometry, calibration.geometry.disc
    return replace(
        SensorModel(),
        skin_radius_mm=geometry.skin_radius_mm,
        camera_distance_mm=geometry.camera_distance_mm,
        # A calibration may find a little more than the simulator clamps.
        visible_half_angle_deg=min(geometry.visible_half_angle_deg, MAX_VISIBLE_HALF_ANGLE_DEG),
        image_height_px=calibration.image_height_px,
        image_width_px=calibration.image_width_px,
        row_c=disc.row_c,
        col_c=disc.col_c,
        disc_radius_px=disc.radius_px,
        pitch_mm=pitch_mm_of(calibration),
        colour_bgr=(1.0, 1.0, 1.0),
        # Glints, noise and tolerances are drawn for each view; here they would be fitted to.
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
        return replace(
            model,
            skin_reflectance=0.1,
            marker_reflectance=0.1,
            pin_reflectance=0.09,
            pin_tip_reflectance=1,
        )
    return replace(model, marker_reflectance=1, pin_tip_reflectance=model.pin_reflectance)


def sensor_with(
    base: SensorModel, kind: Kind, tips: Tips | None, values: F64
) -> tuple[SensorModel, Layout]:
    """The sensor with the values of a fit, and where its pins are."""
    model = replace(with_print(base, kind, values[:4]), blur_px=float(values[-1]))
    return model, tips or Lattice(values[4:-1])


def lattice_px(model: SensorModel, lattice: Lattice, steps: F64) -> F64:
    """Where tips that are so many steps of a lattice from its origin appear:
    (N, 2), col and row.
    """
    r = model.skin_radius_mm
    # Tips lie on a sphere below the skin, by the length of the pins.
    tips = equal_area_to_direction(lattice.at(steps, r), r) * (r - NOMINAL_PITCHES * model.pitch_mm)
    return project(model.geometry, tips)


def tips_px(
    model: SensorModel, layout: Layout, parts: Sequence[tuple[float, float]] = ((0.0, 0.0),)
) -> F64:
    """Where tips appear, (N, 2), col and row; with `parts`,
    what lies parts of the lattice's steps beside them.
    """
    if not parts:
        return np.zeros((0, 2))
    if isinstance(layout, Tips):
        return layout.px
    return lattice_px(
        model, layout, layout.steps(model.skin_radius_mm, 1.05 * reach_mm(model), parts)
    )


def print_of(model: SensorModel, kind: Kind, layout: Layout, moved_px: F64 | float = 0.0) -> Print:
    """The print with the model's pins and markers in these places, tips moved by `moved_px` (N,
    2).
    """
    r = model.skin_radius_mm

    def on_skin(px: F64) -> F64:
        return equal_area(
            sphere_points(model.geometry, px, r - model.pin_length_pitches * model.pitch_mm), r
        )

    pins, markers = tips_px(model, layout) + moved_px, tips_px(model, layout, kind.marker_parts)
    return print_at(model, on_skin(pins), on_skin(markers))


class WhiteMap:
    """The white of the cells of a sensor's pictures."""

    def __init__(self, calibration: Calibration) -> None:
        disc = calibration.geometry.disc
        self._calibration = calibration
        self._mask = disc_mask(
            calibration.image_height_px, calibration.image_width_px, disc
        ).astype(np.uint8)
        self._integrator = Integrator(Window(0, 0, *self._mask.shape), 0)
        self._cells = CellMeans(self._integrator, disc_map.map_grid(disc))
        axis = (np.arange(disc_map.CELLS) + 0.5 - disc_map.CELLS / 2) * (
            2 * disc_map.REACH / disc_map.CELLS
        )
        # Cells at the rim are partly housing.
        self.inside = np.hypot(axis[:, None], axis[None, :]) < 0.93

    def of(self, grey: U8) -> F32:
        """White of a picture, float32 (cells, cells), 0 to 1."""
        c = self._calibration
        return self._cells.means(
            self._integrator.integrate(binarise(grey, self._mask, c.binarisation, c.pitch_px))
        )

    def reference(self) -> F32:
        """White of the reference."""
        return self._cells.means(
            self._integrator.integrate(self._calibration.reference_white)
        ) / np.float32(255)


class TwinRenderer(Renderer):
    """Draws a print under the light of the reference, with compiled motion of the skin."""

    def __init__(self, model: SensorModel, kind: Kind, marks: Print, light: F32) -> None:
        super().__init__(model, marks, kind.profile)
        # The light of the reference, which holds what the model of LEDs does not know.
        self._light = light

    def _carried(self, skin: Skin, chart_mm: F64, friction: float) -> tuple[F64, F64]:
        return compiled.carried(skin, chart_mm, friction)


def sharpness(grey: U8, mask: Bool) -> float:
    """How much steeper a picture is than after a slight blur, as a logarithm;
    it does not depend on the light.
    """

    def steep(image: F32) -> float:
        by_axis = (
            cv2.Sobel(image, cv2.CV_32F, *axis, scale=1 / 8)[mask] for axis in ((1, 0), (0, 1))
        )
        return sum(float(np.square(each).sum()) for each in by_axis)

    image = grey.astype(np.float32)
    return math.log(
        # A ratio, so that it does not depend on the light.
        max(steep(image), 1e-6) / max(steep(cv2.GaussianBlur(image, (0, 0), SHARP_PX)), 1e-6)
    )


def at_rest(model: SensorModel, kind: Kind, marks: Print, light: F32) -> U8:
    """A noiseless picture of the unloaded skin."""
    drawn = TwinRenderer(model, kind, marks, light).draw(undeformed(model.skin_radius_mm))
    return np.asarray(np.clip(drawn + 0.5, 0, 255), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """What a kind of print is fitted to."""

    white: WhiteMap
    reference: F32
    pitch_px: float
    sharp: float
    middle: Bool
    light: F32
    base: SensorModel
    kind: Kind
    tips: Tips | None

    def picture(self, values: F64, moved_px: F64 | float = 0.0) -> U8:
        """A noiseless picture of the unloaded skin of the sensor with these values."""
        model, layout = sensor_with(self.base, self.kind, self.tips, values)
        return at_rest(model, self.kind, print_of(model, self.kind, layout, moved_px), self.light)

    def against(self, sigma_cells: float, moved_px: F64 | float = 0.0) -> Callable[[F64], F64]:
        """The white that values leave unexplained, smoothed over cells, then the sharpness."""

        def soft(cells: F32) -> F64:
            cells = cv2.GaussianBlur(cells, (0, 0), sigma_cells) if sigma_cells else cells
            return np.asarray(cells[self.white.inside], np.float64)

        target = soft(self.reference)

        def residual(values: F64) -> F64:
            picture = self.picture(values, moved_px)
            blurred = SHARPNESS_WEIGHT * (sharpness(picture, self.middle) - self.sharp)
            return np.append(soft(self.white.of(picture)) - target, blurred)

        return residual
