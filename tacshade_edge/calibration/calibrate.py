"""Compute a `Calibration` from references and known presses,
and repeat it when the program has changed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.inputs import Inputs, KnownPress, StatedSensor
from tacshade_edge.calibration.observation import position_mae_mm
from tacshade_edge.calibration.paper_scale import with_paper_scale
from tacshade_edge.calibration.presses.press_selection import (
    Selection,
    agreement_mae_mm,
    select_presses,
)
from tacshade_edge.calibration.presses.table_check import zero_hint
from tacshade_edge.calibration.quality import (
    AGREEMENT_FAIR_MM,
    GRADED_PROFILE,
    UNCALIBRATED,
    Quality,
    assess,
    missing_coverage,
)
from tacshade_edge.calibration.reference import pattern, visible_circle
from tacshade_edge.calibration.reference.marker_field import choose_binarisation
from tacshade_edge.calibration.reference.references import (
    ASSUMED_NOISE_GREY,
    check_references,
    rezero,
    shown_polarity,
    with_reference,
)
from tacshade_edge.calibration.refit import Refit, refit_profile
from tacshade_edge.calibration.sentences import FindingError
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
    warnings: tuple[CalibrationFinding, ...]
    quality: Quality
    presses: tuple[KnownPress, ...] = ()


def calibrate(
    sensor: StatedSensor,
    references: Sequence[U8],
    presses: Sequence[KnownPress] = (),
    *,
    allow_loaded_reference: bool = False,
    networks: Mapping[str, Network] | None = None,
    reference_names: Sequence[str] = (),
) -> CalibrationResult:
    """Fit all that images show of a sensor from at least one image of the unloaded skin and any
    presses. `networks`: those of the profiles to refit.

    Raises ConfigError if that cannot give a calibration; FindingError if findings are why.
    """
    greys = [greyscale.to_grey(image) for image in references]
    unloaded = _unloaded(sensor, greys)
    warnings = check_references(
        unloaded, greys, reference_names, allow_loaded=allow_loaded_reference
    )
    doubt = visible_circle.found_circle_doubt
    if sensor.visible_circle:
        doubt = visible_circle.stated_circle_doubt
    if unsure := doubt(unloaded.reference_grey, unloaded.geometry.disc):
        warnings = (unsure, *warnings)
    if unloaded.pitch_px < FINE_PITCH_PX:
        found = unloaded.pitch_px
        fine = finding(FindingCode.FINE_PATTERN, found_px=found, expected_px=FINE_PITCH_PX)
        warnings += (fine,)
    # Places decide about the polarity better than a reference does.
    if sensor.polarity and not any(press.x_mm is not None for press in presses):
        warnings += _doubted_polarity(sensor.polarity, shown_polarity(unloaded))
    if not presses:
        return CalibrationResult(unloaded, warnings, UNCALIBRATED)
    networks = networks or {}
    selection = select_presses(
        unloaded, presses, networks.get(GRADED_PROFILE), polarity_stated=bool(sensor.polarity)
    )
    made = _fitted(unloaded, selection, networks)
    return replace(made, warnings=warnings + made.warnings)


def _doubted_polarity(stated: Polarity, likely: Polarity) -> tuple[CalibrationFinding, ...]:
    """That the reference shows another polarity than stated, if so."""
    if stated == likely:
        return ()
    code = FindingCode.WHITE_PINS if likely == "dark" else FindingCode.NO_WHITE_PINS
    return (finding(code, found=stated, expected=likely),)


def _fitted(
    unloaded: Calibration, selection: Selection, networks: Mapping[str, Network]
) -> CalibrationResult:
    """The calibration that the selected presses give, with the warnings that are due to them."""
    geometry = unloaded.geometry
    # After the selection, which may have found another polarity, with which the maps are made.
    scaled = with_paper_scale(replace(unloaded, polarity=selection.polarity), selection.presses)
    refits = _refits(scaled, selection, networks)
    fit = Fit(
        presses=len(selection.presses),
        agreement_mae_mm=agreement_mae_mm(selection.observations, geometry),
        position_mae_mm=position_mae_mm(selection.observations),
        profiles={name: refit.fit for name, refit in refits.items()},
    )
    scales = {name: refit.error_scale for name, refit in refits.items()}
    calibration = replace(
        scaled,
        fit=fit,
        factors={name: refit.factor for name, refit in refits.items()},
        error_scales={name: scale for name, scale in scales.items() if scale is not None},
    )
    graded = refits.get(GRADED_PROFILE)
    warnings = selection.warnings
    if graded:
        warnings += _graded_doubts(graded, selection, fit.agreement_mae_mm, geometry)
    missing = missing_coverage(selection.observations, geometry)
    quality = assess(fit, geometry, missing, graded.errors_mm if graded else ())
    return CalibrationResult(calibration, warnings, quality, selection.presses)


def _refits(
    calibration: Calibration, selection: Selection, networks: Mapping[str, Network]
) -> dict[str, Refit]:
    """The profiles whose networks find enough of the presses, refitted to them."""
    refits = {}
    for name, network in networks.items():
        # Selecting the presses has already asked the graded profile's network.
        answers = selection.answers if name == GRADED_PROFILE else ()
        refit = refit_profile(calibration, PROFILES[name], network, selection.presses, answers)
        if refit:
            refits[name] = refit
    return refits


def _graded_doubts(
    graded: Refit, selection: Selection, agreement_mm: float, geometry: Geometry
) -> tuple[CalibrationFinding, ...]:
    """What the refit of the graded profile shows: another zero of the depths, presses of another
    skin, and errors as on no sensor that the networks know.
    """
    zero = zero_hint(graded.found_mm, graded.placed, geometry)
    doubts = (*([zero] if zero else []), *graded.warnings)
    if graded.error_scale is None or graded.error_scale <= UNUSUAL_ERRORS:
        return doubts
    # A fit to labels that contradict each other learns their errors.
    agree = agreement_mm <= AGREEMENT_FAIR_MM * skin_scale(geometry)
    # Nor does it help against a wrong SENSOR.yaml: the twin would be of another sensor.
    is_exact = agree and not (zero or selection.wrong_keys)
    code = FindingCode.FITTABLE_ERRORS if is_exact else FindingCode.UNUSUAL_ERRORS
    return (*doubts, finding(code, factor=graded.error_scale))


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
    if sensor.visible_circle:
        radius_mm = sensor.visible_radius_mm
        if wrong := visible_circle.other_statement(mean, sensor.visible_circle, radius_mm):
            raise FindingError(wrong)
    disc = visible_circle.visible_disc(mean, sensor.visible_circle)
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
        # `with_reference` replaces it: binarising needs a calibration's circle and pitch.
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
    made = calibrate(
        inputs.sensor,
        inputs.references,
        inputs.presses,
        allow_loaded_reference=True,
        networks=networks,
    ).calibration
    return rezero(made, inputs.renewed, allow_loaded=True) if inputs.renewed else made
