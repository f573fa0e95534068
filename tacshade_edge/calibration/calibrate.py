"""Compute a `Calibration` from references and known presses,
and repeat it when the program has changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.inputs import Inputs, KnownPress, StatedSensor
from tacshade_edge.calibration.observation import position_mae_mm
from tacshade_edge.calibration.paper_scale import with_paper_scale
from tacshade_edge.calibration.presses.press_selection import agreement_mae_mm, select_presses
from tacshade_edge.calibration.presses.table_check import zero_hint
from tacshade_edge.calibration.quality import (
    AGREEMENT_FAIR_MM,
    GRADED_PROFILE,
    UNCALIBRATED,
    Quality,
    assess,
    missing_coverage,
)
from tacshade_edge.calibration.reference import pattern
from tacshade_edge.calibration.reference.marker_field import choose_binarisation
from tacshade_edge.calibration.reference.references import (
    ASSUMED_NOISE_GREY,
    check_references,
    rezero,
    shown_polarity,
    with_reference,
)
from tacshade_edge.calibration.refit import refit_profile
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Calibration, Fit, Geometry, Polarity

FINE_PITCH_PX = 6.0
"""Pitch of the markers below which errors grow (docs/results/image-size.md)."""
UNUSUAL_ERRORS = 1.4
"""Error scale of the graded profile above which a warning is due (at most 1.34 on six sensors of
the trained family, 1.38 or more on six of the other).
"""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """A calibration, warnings for the user, its quality, and the presses that were used."""

    calibration: Calibration
    warnings: tuple[str, ...]
    quality: Quality
    presses: tuple[KnownPress, ...] = ()


def calibrate(
    sensor: StatedSensor,
    references: Sequence[U8],
    presses: Sequence[KnownPress] = (),
    allow_loaded_reference: bool = False,
    networks: Mapping[str, Network] | None = None,
    reference_names: Sequence[str] = (),
) -> CalibrationResult:
    """Fit all that images show of a sensor from at least one image of the unloaded skin and any
    presses. `networks`: those of the profiles to refit.

    Raises ConfigError if that cannot give a calibration.
    """
    greys = [greyscale.to_grey(image) for image in references]
    unloaded = _unloaded(sensor, greys)
    warnings = check_references(unloaded, greys, allow_loaded_reference, reference_names)
    judge = pattern.stated_warning if sensor.visible_circle else pattern.rim_warning
    if unsure := judge(unloaded.reference_grey, unloaded.geometry.disc):
        warnings = (unsure, *warnings)
    warnings += _fine_pattern(unloaded.pitch_px)
    if sensor.polarity and not any(press.x_mm is not None for press in presses):
        warnings += _doubted_polarity(sensor.polarity, shown_polarity(unloaded))
    if not presses:
        return CalibrationResult(unloaded, warnings, UNCALIBRATED)
    networks, geometry = networks or {}, unloaded.geometry
    selection = select_presses(
        unloaded, presses, networks.get(GRADED_PROFILE), polarity_stated=bool(sensor.polarity)
    )
    fitted = with_paper_scale(replace(unloaded, polarity=selection.polarity), selection.presses)
    made = {
        name: refit_profile(
            fitted,
            PROFILES[name],
            each,
            selection.presses,
            selection.answers if name == GRADED_PROFILE else (),
        )
        for name, each in networks.items()
    }
    refits = {name: refit for name, refit in made.items() if refit}
    fit = Fit(
        presses=len(selection.presses),
        agreement_mae_mm=agreement_mae_mm(selection.observations, geometry),
        position_mae_mm=position_mae_mm(selection.observations),
        profiles={name: refit.fit for name, refit in refits.items()},
    )
    fitted = replace(
        fitted,
        fit=fit,
        factors={name: refit.factor for name, refit in refits.items()},
        error_scales={
            name: refit.error_scale
            for name, refit in refits.items()
            if refit.error_scale is not None
        },
    )
    warnings += selection.warnings
    graded = refits.get(GRADED_PROFILE)
    if graded:
        if hint := zero_hint(graded.found_mm, graded.placed, geometry):
            warnings += (hint,)
        warnings += graded.warnings
        if graded.error_scale is not None and graded.error_scale > UNUSUAL_ERRORS:
            words = (
                f"off {graded.error_scale:.1f} times as much as on sensors that the networks know"
            )
            # A fit to labels that contradict each other learns their errors.
            is_exact = not (
                hint or selection.wrong_keys
            ) and fit.agreement_mae_mm <= AGREEMENT_FAIR_MM * skin_scale(geometry)
            advice = "; --fit may help" if is_exact else ""
            warnings += (f"heights are {words}, and their intervals are that much wider{advice}",)
    missing = missing_coverage(selection.observations, geometry)
    quality = assess(fit, geometry, missing, graded.errors_mm if graded else ())
    return CalibrationResult(fitted, warnings, quality, selection.presses)


def _fine_pattern(pitch_px: float) -> tuple[str, ...]:
    """A warning if the image is too small for its marker pattern."""
    if pitch_px >= FINE_PITCH_PX:
        return ()
    found = f"found a pitch of {pitch_px:.1f} px, expected at least {FINE_PITCH_PX:g}"
    why = "heights may be off up to twice as much; take larger images (source.width_px)"
    return (f"markers: {found}: {why}",)


def _doubted_polarity(stated: Polarity, likely: Polarity) -> tuple[str, ...]:
    """A warning if the reference shows another polarity than stated."""
    pins = "white pins on black, as of a TacTip" if likely == "dark" else "no white pins on black"
    shown = f"polarity: found {stated}, expected {likely}: the reference shows {pins}"
    return () if stated == likely else (shown,)


def _unloaded(sensor: StatedSensor, greys: Sequence[U8]) -> Calibration:
    """The calibration that the references alone give."""
    if not greys:
        raise ConfigError(
            "found no reference image, expected at least one image of the untouched skin"
        )
    for number, grey in enumerate(greys, start=1):
        if grey.shape != greys[0].shape:
            raise ConfigError(
                f"reference {number}: found {grey.shape[1]}x{grey.shape[0]} px, "
                f"expected {greys[0].shape[1]}x{greys[0].shape[0]} px as in the first reference"
            )
    mean = pattern.mean_image(greys)
    disc = pattern.visible_disc(mean, sensor.visible_circle)
    pitch_px = pattern.marker_pitch_px(mean, disc)
    calibration = Calibration(
        geometry=Geometry(
            sensor.skin_radius_mm,
            sensor.camera_distance_mm,
            sensor.visible_half_angle_deg,
            disc,
            sensor.pad_radius_mm,
        ),
        polarity=sensor.polarity or "bright",
        binarisation=sensor.binarisation or choose_binarisation(mean, disc, pitch_px),
        image_height_px=mean.shape[0],
        image_width_px=mean.shape[1],
        pitch_px=pitch_px,
        reference_white=np.zeros_like(mean),
        reference_grey=mean,
        noise_grey=ASSUMED_NOISE_GREY,
        alpha=sensor.alpha,
        flange_T_sensor=sensor.flange_T_sensor,
    )
    made = with_reference(calibration, greys)
    return made if sensor.polarity else replace(made, polarity=shown_polarity(made))


def inputs_of(
    sensor: StatedSensor, references: Sequence[U8], presses: Sequence[KnownPress]
) -> Inputs:
    """Keep the inputs of `calibrate`, the images in grey, which is all that it uses."""
    greys = tuple(to_grey(image) for image in references)
    return Inputs(
        sensor, greys, tuple(replace(press, image=to_grey(press.image)) for press in presses)
    )


def with_new_reference(inputs: Inputs, images: Sequence[U8]) -> Inputs:
    """The same inputs after `rezero` with these images."""
    return replace(inputs, renewed=tuple(to_grey(image) for image in images))


def make_again(inputs: Inputs, networks: Mapping[str, Network]) -> Calibration:
    """Repeat a calibration with the present program.

    Raises ConfigError if that can no longer use these inputs.
    """
    # The first calibration already warned of a loaded reference, or rejected it.
    made = calibrate(inputs.sensor, inputs.references, inputs.presses, True, networks).calibration
    return rezero(made, inputs.renewed, True) if inputs.renewed else made
