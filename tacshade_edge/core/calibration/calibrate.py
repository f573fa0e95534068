"""References and ball presses to a `Calibration`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.calibration import gain, pattern, press_checks
from tacshade_edge.core.calibration.grade import Verdict, judge
from tacshade_edge.core.calibration.reference_load import loaded_reason
from tacshade_edge.core.contact.gate import ContactGate
from tacshade_edge.core.depth import Network
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.frame_check import registration
from tacshade_edge.core.frame_check.validity import FrameCheck, invalid_reason, sensor_check
from tacshade_edge.core.geometry.disc import Grid, Window, disc_mask, disc_rays
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.binarise import Binariser, odd
from tacshade_edge.core.image.grey_maps import GreyMapper
from tacshade_edge.core.image.integral_image import BoxSums, Integrator
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import F32, IDENTITY_POSE, U8, Binarisation, Calibration, Geometry, Polarity

# The maps that references and presses are judged by.
PROFILE = replace(PROFILES["accurate"], name="calibration", tv_weight=0.05, gate_levels=20, gate_dark_levels=12)
# The profile whose error says how good a calibration is.
JUDGED = "accurate"
MIN_PRESSES = 8
MAX_LEFT_OUT = 0.25
# RMS of g between frames of one still scene when one reference alone cannot tell it.
ASSUMED_NOISE_GREY = 1.0
# A new reference with less contrast than this part of the old one's cannot serve the old refit.
WORN_CONTRAST = 0.6


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a person states of a sensor (SENSOR.yaml)."""

    skin_radius_mm: float
    camera_distance_mm: float | None
    visible_half_angle_deg: float
    polarity: Polarity
    alpha: float = 15.0
    binarisation: Binarisation = "adaptive"
    flange_T_sensor: tuple[float, ...] = IDENTITY_POSE


@dataclass(frozen=True, slots=True, eq=False)
class BallPress:
    """A known press of a ball: its image and the row of PRESSES.csv; x and y None where they are to be located."""

    name: str
    image: U8
    radius_mm: float
    depth_mm: float
    x_mm: float | None
    y_mm: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A calibration and what a person should hear about it."""

    calibration: Calibration
    warnings: tuple[str, ...]
    verdict: Verdict


def calibrate(
    sensor: Sensor,
    references: Sequence[U8],
    presses: Sequence[BallPress] = (),
    allow_loaded_reference: bool = False,
    networks: Mapping[str, Network] | None = None,
) -> Calibrated:
    """Fit everything that images can tell of a sensor.

    Parameters
    ----------
    sensor : Sensor
    references : sequence of uint8 (H, W) or (H, W, 3)
        At least one, of the unloaded skin.
    presses : sequence of BallPress
        None, or at least `MIN_PRESSES`.
    allow_loaded_reference : bool
        Warn instead of refusing.
    networks : mapping of str to Network, optional
        Of each profile that is to be refitted to the presses.

    Raises
    ------
    ConfigError
        With the reason why it cannot work.
    """
    greys = [greyscale.to_grey(image) for image in references]
    if not greys:
        raise ConfigError("no reference image: expected at least one of the unloaded skin")
    for index, grey in enumerate(greys):
        if grey.shape != greys[0].shape:
            raise ConfigError(
                f"reference {index + 1} is {grey.shape[1]}x{grey.shape[0]} px, "
                f"the first is {greys[0].shape[1]}x{greys[0].shape[0]}"
            )
    mean = pattern.mean_image(greys)
    disc = pattern.find_disc(mean)
    geometry = Geometry(sensor.skin_radius_mm, sensor.camera_distance_mm, sensor.visible_half_angle_deg, disc)
    warnings: list[str] = []
    unloaded = _with_reference(
        Calibration(
            geometry=geometry,
            polarity=sensor.polarity,
            binarisation=sensor.binarisation,
            image_height_px=mean.shape[0],
            image_width_px=mean.shape[1],
            pitch_px=pattern.marker_pitch_px(mean, disc),
            reference_white=np.zeros_like(mean),
            reference_grey=mean,
            noise_grey=ASSUMED_NOISE_GREY,
            alpha=sensor.alpha,
            flange_T_sensor=sensor.flange_T_sensor,
        ),
        greys,
    )
    if len(greys) < 3:
        warnings.append(f"{len(greys)} reference: noise assumed to be {ASSUMED_NOISE_GREY} grey levels; 5 are better")
    loaded = loaded_reason(Preprocessor(unloaded, PROFILE))
    if loaded and not allow_loaded_reference:
        raise ConfigError(f"{loaded}; take it again without contact, or pass --allow-loaded-reference")
    if loaded:
        warnings.append(loaded)
    warnings += _check_references(unloaded, greys, allow_loaded_reference)
    if not presses:
        return Calibrated(unloaded, tuple(warnings), judge({}, geometry, (), ()))
    usable, rows, told = _usable_presses(unloaded, presses)
    fitted = replace(
        unloaded,
        # The paper's α for this sensor: what scales a normalised height of 1 to the mean pressed depth.
        alpha=float(np.mean([press.depth_mm for press in usable])) / geometry.mm_per_px,
        fit={
            "presses": float(len(usable)),
            "agreement_mae_mm": press_checks.agreement_mm(rows, geometry),
            "position_mae_mm": press_checks.position_mae_mm(rows),
        },
    )
    worst: list[tuple[str, float]] = []
    for name, network in (networks or {}).items():
        fitted, errors = _refit(fitted, usable, PROFILES[name], network)
        worst = sorted(errors, key=lambda row: -abs(row[1])) if name == JUDGED else worst
    verdict = judge(fitted.fit, geometry, press_checks.coverage(rows, geometry), worst)
    return Calibrated(fitted, (*warnings, *told), verdict)


def rezero(calibration: Calibration, images: Sequence[U8], allow_loaded: bool = False) -> Calibration:
    """The same calibration with a reference from new images of the unloaded skin.

    Parameters
    ----------
    calibration : Calibration
    images : sequence of uint8 (H, W) or (H, W, 3)
    allow_loaded : bool
        Take it even when the skin seems touched.

    Raises
    ------
    ConfigError
        An image cannot be used, the camera moved too far for the calibration's geometry, or the skin is touched.
    """
    if not images:
        raise ConfigError("no image to take a reference from")
    greys = [greyscale.to_grey(image) for image in images]
    geometry = calibration.geometry
    check = sensor_check(calibration)
    for grey in greys:
        if reason := invalid_reason(grey, check):
            raise ConfigError(f"reference refused: {reason}")
    old = registration.look(calibration.reference_grey, geometry.disc, calibration.pitch_px)
    for found in (registration.drift(old, grey) for grey in greys):
        if registration.shifted_too_far(found, geometry.disc):
            shifted = registration.shift_reason(found, geometry.disc)
            raise ConfigError(f"reference refused: {shifted}; fix the camera where it was, or calibrate again")
        if found.contrast < WORN_CONTRAST:
            raise ConfigError(
                f"reference refused: {found.contrast:.2f} times the contrast, expected {WORN_CONTRAST} or more: "
                "clean or focus the lens, or calibrate again"
            )
    renewed = _with_reference(replace(calibration, reference_grey=pattern.mean_image(greys), crc32=0), greys)
    if not allow_loaded and (loaded := loaded_reason(Preprocessor(renewed, PROFILE))):
        raise ConfigError(f"reference refused: {loaded}")
    return renewed


def _with_reference(calibration: Calibration, greys: Sequence[U8]) -> Calibration:
    """Binarise the references, average them, and measure how much g differs between them."""
    geometry = calibration.geometry
    height, width = calibration.image_height_px, calibration.image_width_px
    window = Window.of_disc(height, width, geometry.disc)
    mask = window.cut(disc_mask(height, width, geometry.disc).astype(np.uint8))
    side = odd(PROFILE.window_pitches * calibration.pitch_px)
    grid, integrator = Grid.of_window(window, PROFILE.stride_px), Integrator(window, side // 2 + 1)
    box_sums = BoxSums(integrator, grid, side)
    total, inside = box_sums.sums(integrator.integrate(mask)), disc_rays(grid, geometry).inside
    binariser = Binariser(mask, calibration.binarisation, calibration.pitch_px)
    white_sum: F32 = np.zeros((height, width), dtype=np.float32)
    ratios = []
    for grey in greys:
        white = binariser(window.cut(grey))
        window.cut(white_sum)[...] += white
        ratios.append(greyscale.white_ratio(box_sums.sums(integrator.integrate(white)), total)[inside])
    noise = calibration.noise_grey
    if len(greys) >= 3:
        noise = float(np.sqrt(np.mean(np.var(np.stack(ratios), axis=0, ddof=1))))
    reference = np.rint(white_sum * (255 / len(greys))).astype(np.uint8)
    return replace(calibration, reference_white=reference, noise_grey=noise)


def _check_references(calibration: Calibration, greys: Sequence[U8], allow_loaded: bool) -> list[str]:
    """Warnings where the references differ from each other; refuses what no mean of them can mend."""
    disc = calibration.geometry.disc
    first = registration.look(greys[0], disc, calibration.pitch_px)
    warnings = []
    for number, grey in enumerate(greys[1:], start=2):
        found = registration.drift(first, grey)
        shifted = registration.shift_reason(found, disc)
        if registration.shifted_too_far(found, disc):
            raise ConfigError(
                f"reference {number}: {shifted} since reference 1; fix the camera and take them all again"
            )
        if change := shifted or registration.light_drift_reason(found):
            warnings.append(f"reference {number}: {change} against reference 1")
    # A pressed reference raises the measured noise, and would hide behind it.
    preprocessor = Preprocessor(replace(calibration, noise_grey=ASSUMED_NOISE_GREY), PROFILE)
    gate = ContactGate(preprocessor)
    pressed = [str(number) for number, grey in enumerate(greys, start=1) if gate.opens(preprocessor.preprocess(grey))]
    if pressed:
        reason = f"reference {', '.join(pressed)}: seems pressed, it differs from the mean of all references"
        if not allow_loaded:
            raise ConfigError(f"{reason}; take it again without contact, or pass --allow-loaded-reference")
        warnings.append(reason)
    return warnings


def _usable_presses(
    unloaded: Calibration, presses: Sequence[BallPress]
) -> tuple[list[BallPress], list[press_checks.Evidence], list[str]]:
    """The presses to fit, what their images show, and what is to be said of the others.

    A press without contact, of a camera that moved, or that disagrees with what is stated of it is left out and told,
    up to `MAX_LEFT_OUT` of them.
    """
    if len(presses) < MIN_PRESSES:
        raise ConfigError(f"{len(presses)} presses: at least {MIN_PRESSES} are needed (20 are better)")
    geometry = unloaded.geometry
    preprocessor = Preprocessor(unloaded, PROFILE)
    grey_mapper, gate, check = GreyMapper(preprocessor), ContactGate(preprocessor), sensor_check(unloaded)
    reference = registration.look(unloaded.reference_grey, geometry.disc, unloaded.pitch_px)
    kept: list[BallPress] = []
    left_out: list[str] = []
    warnings: list[str] = []
    for press in presses:
        _check_press(unloaded, check, press)
        found = registration.drift(reference, greyscale.to_grey(press.image))
        shifted = registration.shift_reason(found, geometry.disc)
        if registration.shifted_too_far(found, geometry.disc):
            left_out.append(f"{press.name}: {shifted} since the references")
        elif not gate.opens(preprocessor.preprocess(greyscale.to_grey(press.image))):
            left_out.append(f"{press.name}: no contact to be seen, {press.depth_mm} mm is stated")
        else:
            kept.append(press)
            if reason := shifted or registration.light_drift_reason(found):
                warnings.append(f"{press.name}: {reason} since the references")
    rows = [
        press_checks.gather_evidence(
            preprocessor,
            p.name,
            grey_mapper.maps(preprocessor.preprocess(greyscale.to_grey(p.image))),
            (p.radius_mm, p.depth_mm, p.x_mm, p.y_mm),
        )
        for p in kept
    ]
    hints = list(press_checks.hints(rows, geometry)) if len(rows) >= MIN_PRESSES else []
    wrong = {found.index: found.reason for found in press_checks.disagreements(rows, geometry)}
    left_out += wrong.values()
    usable = [k for k in range(len(kept)) if k not in wrong]
    if len(left_out) > MAX_LEFT_OUT * len(presses) or len(usable) < MIN_PRESSES:
        raise ConfigError("; ".join([f"{len(left_out)} of {len(presses)} presses cannot be used", *hints, left_out[0]]))
    told = [*hints, *warnings, *(f"{reason}; left out" for reason in left_out)]
    return [kept[k] for k in usable], [rows[k] for k in usable], told


def _refit(
    calibration: Calibration, presses: Sequence[BallPress], profile: Profile, network: Network
) -> tuple[Calibration, list[tuple[str, float]]]:
    """Refit a profile to the presses.

    And how far off (mm) the greatest h of each press is with weights that were fitted without it.
    """
    geometry = calibration.geometry
    preprocessor = Preprocessor(calibration, profile)
    solver = LearnedSolver(preprocessor, network)
    rows, tops, names = [], [], []
    for press in presses:
        inverse = solver.inverse(preprocessor.preprocess(preprocessor.grey(press.image)))
        if press.x_mm is not None and press.y_mm is not None:
            ball: gain.Ball | None = gain.stated_ball(geometry, press.x_mm, press.y_mm, press.depth_mm, press.radius_mm)
        else:
            ball = gain.located_ball(geometry, inverse, press.depth_mm, press.radius_mm)
        made = gain.press_rows(inverse, geometry, ball) if ball is not None else None
        if made is not None and ball is not None:
            rows.append(made)
            tops.append((inverse, ball.depth_max_mm(geometry.skin_radius_mm)))
            names.append(press.name)
    factor = gain.fit_factor(rows)
    if factor is None:
        return calibration, []
    errors = []
    for k, (inverse, top_mm) in enumerate(tops):
        without = gain.fit_factor(rows[:k] + rows[k + 1 :]) or 1.0
        height = inverse.height_mm * np.float32(without)
        errors.append(float(height[inverse.contact_logit > 0].max()) - top_mm)
    off = np.abs(errors)
    figures = {
        f"{profile.name}_presses": float(len(rows)),
        f"{profile.name}_depth_mae_mm": float(off.mean()),
        f"{profile.name}_depth_worst_mm": float(off.max()),
    }
    refitted = replace(
        calibration, factors={**calibration.factors, profile.name: factor}, fit=calibration.fit | figures
    )
    return refitted, list(zip(names, errors, strict=True))


def _check_press(calibration: Calibration, check: FrameCheck, press: BallPress) -> None:
    """Refuse what cannot be a press of this sensor."""
    r = calibration.geometry.skin_radius_mm
    if press.image.shape[:2] != (calibration.image_height_px, calibration.image_width_px):
        raise ConfigError(
            f"{press.name}: {press.image.shape[1]}x{press.image.shape[0]} px, "
            f"the reference is {calibration.image_width_px}x{calibration.image_height_px}"
        )
    if not 0 < press.depth_mm < r or not press.radius_mm > 0:
        raise ConfigError(
            f"{press.name}: depth {press.depth_mm} mm, ball radius {press.radius_mm} mm; "
            f"expected 0 < depth < {r} and a radius above 0"
        )
    if reason := invalid_reason(greyscale.to_grey(press.image), check):
        raise ConfigError(f"{press.name}: not usable: {reason}")
