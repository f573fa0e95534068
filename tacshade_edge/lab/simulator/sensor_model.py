"""Every parameter of a simulated TacShade, and random members of the family."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from msgspec import Meta

from tacshade_edge.types import Disc, Geometry, Skin
from tacshade_edge.types.calibration import Coordinate, Positive, require_bounds

Surround = Literal["bright", "dark"]
NotNegative = Annotated[float, Meta(ge=0, lt=1e6)]
Part = Annotated[float, Meta(ge=0, le=1)]

RIM_HALF_ANGLE_DEG = 72.0
"""Angle at O from +z at which the housing clamps the skin (h = 0);
the visible circle must lie inside.
"""

MAX_VISIBLE_HALF_ANGLE_DEG = 62.0


@dataclass(frozen=True, slots=True)
class SensorModel:
    """The parameters of one sensor: skin, pins and markers, camera, light.

    Radii in pitches are radii, not diameters.

    Skin: r, d (None: orthographic) and θ as in `Geometry`. A pad is the flat skin of the size of
    such a dome, with the same visible circle, whose radius is r sinθ; λ `skin_decay_mm` and λt
    `drag_decay_mm` are lengths over which displacements decay outside a contact. With `friction` 1
    the skin goes along -z with what presses it, with 0 along its radius; `coulomb` is μ kn / kt.
    `sway` is the part of a drag that the whole dome takes, `bulge` the part of the displaced volume
    that bulges out at its sides, `pin_lag` the part of a drag by which tips of pins lag behind.
    `creep_part` is how much of its deformation creeps under a held load, `creep_s` the time
    constant; only scenes that move in time creep.

    Print: a hexagonal lattice of pins, frusta that point inwards, and markers at the centres of its
    triangles, which merge over 0.29 pitches. Tolerances are standard deviations of a feature's
    place, and of its size as a ratio.

    Image: `light` is the grey level of a feature of reflectance 1 in the middle, `vignetting` the
    part lost at the edge, `colour_bgr` the gain of each channel; blur and noise are standard
    deviations, shot noise that at level 255. Specular spots are LED highlights, which do not move
    with the skin.
    """

    skin: Skin = "dome"
    skin_radius_mm: Positive = 20.0
    camera_distance_mm: Coordinate | None = 14.0
    visible_half_angle_deg: Annotated[float, Meta(ge=0.05, le=MAX_VISIBLE_HALF_ANGLE_DEG)] = 50.0
    image_height_px: Annotated[int, Meta(gt=0)] = 480
    image_width_px: Annotated[int, Meta(gt=0)] = 640
    row_c: Coordinate = 236.4
    col_c: Coordinate = 327.7
    disc_radius_px: Positive = 205.0
    pitch_mm: Positive = 1.9
    lattice_rotation_deg: NotNegative = 7.0
    # Long pins with wide tips: with shorter or thinner ones, contact darkens (see `tactip`).
    # This is how a TacShade brightens: such pins hide most of the white of the concave skin, and
    # part where it flattens.
    pin_length_pitches: Positive = 1.6
    pin_tip_radius_pitches: Positive = 0.36
    pin_base_radius_pitches: Positive = 0.28
    marker_radius_pitches: Positive = 0.42
    position_tolerance_mm: NotNegative = 0.03
    size_tolerance: NotNegative = 0.03
    skin_decay_mm: Positive = 2.2
    friction: Part = 1.0
    drag_decay_mm: Positive = 4.0
    coulomb: NotNegative = 1.5
    sway: Annotated[float, Meta(ge=0, le=0.9)] = 0.2
    bulge: Part = 0.0
    pin_lag: Part = 0.1
    creep_part: Annotated[float, Meta(ge=0, le=1 / 9)] = 0.08
    creep_s: Positive = 0.7
    light: NotNegative = 205.0
    vignetting: NotNegative = 0.35
    marker_reflectance: NotNegative = 0.95
    skin_reflectance: NotNegative = 0.14
    pin_reflectance: NotNegative = 0.07
    pin_tip_reflectance: NotNegative = 0.07
    colour_bgr: tuple[float, float, float] = (1.08, 1.0, 0.93)
    blur_px: NotNegative = 0.7
    read_noise_grey: NotNegative = 1.5
    shot_noise_grey: NotNegative = 2.5
    surround: Surround = "bright"
    specular_spots: int = 4
    # Not the seed of the noise: two pictures of a sensor differ in noise, never in print.
    print_seed: int = 0

    def __post_init__(self) -> None:
        """Raise ValueError with the parameter's name for a value that cannot be simulated."""
        require_bounds(self)
        _, size_mm = self.form_mm
        # Coarser, no pattern repeats in the circle; finer, it is grey to the camera.
        if self.pitch_mm > size_mm / 3 or self.pitch_mm < size_mm / 50:
            raise ValueError(
                f"pitch_mm is {self.pitch_mm}, expected a 50th to a third of skin_radius_mm"
            )
        # Such tips would come near O, where neighbouring pins meet.
        if self.pin_length_pitches * self.pitch_mm > size_mm / 2:
            raise ValueError(
                f"pin_length_pitches is {self.pin_length_pitches}: "
                "pins longer than half the skin's radius"
            )
        if self.skin not in ("dome", "pad"):
            raise ValueError(f"skin is {self.skin!r}, expected dome or pad")
        # The volume of what a pad yields has no sides to go to.
        if self.skin == "pad" and self.bulge:
            raise ValueError(f"bulge is {self.bulge}, expected 0 for a pad")
        if self.camera_distance_mm is not None and not self.geometry.f_px > 0:
            text = f"camera_distance_mm is {self.camera_distance_mm}"
            raise ValueError(f"{text}, expected a lens behind the visible circle")
        if self.surround not in ("bright", "dark"):
            raise ValueError(f"surround is {self.surround!r}, expected bright or dark")

    @property
    def geometry(self) -> Geometry:
        """The geometry that a perfect calibration of this sensor finds."""
        disc = Disc(self.row_c, self.col_c, self.disc_radius_px)
        r, d, angle_deg = self.skin_radius_mm, self.camera_distance_mm, self.visible_half_angle_deg
        if self.skin == "pad":
            return Geometry(math.inf, d, 0.0, disc, r * math.sin(math.radians(angle_deg)))
        return Geometry(r, d, angle_deg, disc)

    @property
    def form_mm(self) -> tuple[float, float]:
        """Radius of the undeformed skin, infinite for a pad, and the skin's size,
        as in `skin.undeformed`.
        """
        if self.skin == "pad":
            return math.inf, self.skin_radius_mm
        return self.skin_radius_mm, self.geometry.size_mm


# Each stream draws in the order of these lines, and tests, golden results and result pages know
# sensors by their seeds: a new parameter takes a new stream, as drag and creep did.
_LENS = {
    "skin_radius_mm": (17.0, 28.0),
    "camera_distance_mm": (6.0, 26.0),
    "visible_half_angle_deg": (42.0, 55.0),
}
_PRINT_AND_SKIN = {
    "pitch_mm": (1.5, 2.4),
    "lattice_rotation_deg": (0.0, 60.0),
    "pin_length_pitches": (1.4, 2.0),
    "pin_tip_radius_pitches": (0.33, 0.38),
    "pin_base_radius_pitches": (0.24, 0.32),
    "marker_radius_pitches": (0.35, 0.48),
    "position_tolerance_mm": (0.01, 0.05),
    "size_tolerance": (0.01, 0.05),
    "skin_decay_mm": (1.5, 3.5),
    "friction": (0.8, 1.0),
}
_DRAG_STREAM = 4
_DRAG = {
    "drag_decay_mm": (2.5, 8.0),
    "coulomb": (0.8, 4.0),
    "sway": (0.0, 0.5),
    "pin_lag": (0.0, 0.3),
}
_CREEP_STREAM = 6
_CREEP_PART = {"creep_part": (0.0, 0.11)}
_CREEP_S = (0.1, 3.0)
_LIGHT = {
    "light": (140.0, 235.0),
    "vignetting": (0.1, 0.5),
    "marker_reflectance": (0.85, 1.0),
    "skin_reflectance": (0.08, 0.2),
    "pin_reflectance": (0.04, 0.1),
}
_BLUE, _RED = (1.0, 1.15), (0.85, 1.0)
_NOISE = {
    "blur_px": (0.4, 1.2),
    "read_noise_grey": (0.8, 3.0),
    "shot_noise_grey": (1.0, 4.0),
}
_BRIGHT_PART = 0.6
_SPOTS_MAX = 6


def random_model(seed: int, image_height_px: int = 480, image_width_px: int = 640) -> SensorModel:
    """Draw a sensor of the TacShade family with random print, lens and light; the same seed gives
    the same sensor. The ranges exclude sensors that a ball darkens.
    """
    rng = np.random.default_rng(seed)
    drag_rng = np.random.default_rng((seed, _DRAG_STREAM))
    creep_rng = np.random.default_rng((seed, _CREEP_STREAM))
    side_px = min(image_height_px, image_width_px)
    disc_radius_px = side_px * float(rng.uniform(0.36, 0.45))
    # The circle stays inside the picture, wherever its middle is drawn.
    slack_px = 0.5 * side_px - disc_radius_px
    return SensorModel(
        image_height_px=image_height_px,
        image_width_px=image_width_px,
        disc_radius_px=disc_radius_px,
        print_seed=seed,
        **_drawn(rng, _LENS),
        row_c=(image_height_px - 1) / 2 + float(rng.uniform(-0.8, 0.8)) * slack_px,
        col_c=(image_width_px - 1) / 2 + float(rng.uniform(-0.8, 0.8)) * slack_px,
        **_drawn(rng, _PRINT_AND_SKIN),
        **_drawn(drag_rng, _DRAG),
        **_drawn(creep_rng, _CREEP_PART),
        creep_s=float(np.exp(creep_rng.uniform(math.log(_CREEP_S[0]), math.log(_CREEP_S[1])))),
        **_drawn(rng, _LIGHT),
        colour_bgr=(float(rng.uniform(*_BLUE)), 1.0, float(rng.uniform(*_RED))),
        **_drawn(rng, _NOISE),
        surround="bright" if rng.random() < _BRIGHT_PART else "dark",
        specular_spots=int(rng.integers(0, _SPOTS_MAX + 1)),
    )


def _drawn(rng: np.random.Generator, ranges: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    return {name: float(rng.uniform(*span)) for name, span in ranges.items()}


def flattened(model: SensorModel) -> SensorModel:
    """A pad with the print of a sensor, and with its visible circle as large and as far
    from the lens.
    """
    d = model.camera_distance_mm
    if d is not None:
        # The rim of the circle lies this far from O, in whose plane a pad lies.
        d += model.skin_radius_mm * math.cos(math.radians(model.visible_half_angle_deg))
    return replace(model, skin="pad", camera_distance_mm=d, bulge=0.0)


def tactip(model: SensorModel) -> SensorModel:
    """Print the same skin as a TacTip: white pin tips on black, without markers,
    so that contact darkens the image.
    """
    return replace(
        model,
        pin_length_pitches=1.0,
        pin_tip_radius_pitches=0.26,
        pin_base_radius_pitches=0.26,
        marker_reflectance=model.skin_reflectance,
        pin_reflectance=model.skin_reflectance,
        pin_tip_reflectance=0.95,
    )
