"""Make a reference from images of the unloaded skin, check it, and follow it as light ages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.calibration.findings import CalibrationFinding, FindingCode, finding
from tacshade_edge.calibration.reference import pattern
from tacshade_edge.calibration.reference.pressed_skin import load_finding
from tacshade_edge.calibration.sentences import FindingError, sentence
from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.gate import GATE_MM2, ContactGate
from tacshade_edge.sensor.frame_check import camera_drift, picture, plain_judges
from tacshade_edge.sensor.frame_check.camera_drift import Drift
from tacshade_edge.sensor.frame_check.picture import DRIFT_LEVELS
from tacshade_edge.sensor.geometry.disc import disc_mask, least_area_mm2
from tacshade_edge.sensor.image import greyscale
from tacshade_edge.sensor.image.preprocess import Preprocessor
from tacshade_edge.sensor.image.white import eighth
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import U8, Calibration, Disc, Polarity

PROFILE = replace(PROFILES["accurate"], name="calibration", tv_weight=0.05, network=None)
"""Profile of the maps that compare references and presses:
of whole images, and without a network.
"""
ASSUMED_NOISE_GREY, NOISE_REFERENCES = 1.0, 3
"""Noise of g, RMS in grey levels, assumed for fewer references than the second."""
ADVISED_REFERENCES = 5
# A reference of which more has changed against the mean of all is pressed:
# a tip that sways reaches 0.22 (raw TacTips).
LOADED_PART = 0.23
# The old refit does not hold for a new reference with less than this part of the old contrast.
_WORN_CONTRAST = 0.6
# Part of the disc's radius in which a reference shows its polarity, relative width (log) of the
# ring around the pattern's fundamental, and the least skewness of white pins: 0.72 to 1.3 on
# TacTips, simulated and real, 0.55 at most on others (0.19 to 0.55 on square lattices, below 0 on
# hexagonal ones).
_MIDDLE, _RING_WIDTH, _WHITE_PINS = 0.5, 0.25, 0.63


def with_reference(calibration: Calibration, greys: Sequence[U8]) -> Calibration:
    """Replace the reference by the mean of binarised images,
    and the noise by the deviation of g between them.
    """
    prepared = Preprocessor(calibration, PROFILE)
    whites = [prepared.binarised(grey) for grey in greys]
    # Between fewer images, chance would decide about the gate.
    noise = calibration.noise_grey
    if len(greys) >= NOISE_REFERENCES:
        ratios = [
            prepared.ratio(prepared.integrator.integrate(white))[prepared.rays.inside]
            for white in whites
        ]
        noise = float(np.sqrt(np.mean(np.var(np.stack(ratios), axis=0, ddof=1))))
    reference_white = np.zeros_like(greys[0])
    prepared.window.cut(reference_white)[...] = np.rint(
        np.sum(whites, axis=0) * np.float32(255 / len(greys))
    )
    return replace(
        calibration,
        reference_white=reference_white,
        reference_grey=pattern.mean_image(greys),
        noise_grey=noise,
    )


def shown_polarity(calibration: Calibration) -> Polarity:
    """The likely polarity of a reference: dark if white pins stand on black, as a TacTip's do.

    Pins stand on a hexagonal lattice, so the third moment of the pattern's fundamental has the sign
    of its peaks.
    """
    disc, pitch_px = calibration.geometry.disc, calibration.pitch_px
    shape = height, width = calibration.image_height_px, calibration.image_width_px
    # Two pitches: light varies more slowly, markers do not.
    side = 2 * round(pitch_px) + 1
    detail = calibration.reference_grey - cv2.blur(
        calibration.reference_grey.astype(np.float32), (side, side)
    )
    contrast = np.sqrt(np.maximum(cv2.blur(detail * detail, (side, side)), 0)) + 1
    even = np.where(disc_mask(height, width, disc), np.clip(detail / contrast, -2, 2), 0)
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])) * (
        pitch_px * 3**0.5 / 2
    )
    ring = np.exp(-0.5 * (np.log(np.maximum(frequency, 1e-6)) / _RING_WIDTH) ** 2)
    wave = np.fft.irfft2(np.fft.rfft2(even) * ring, s=shape)
    middle = wave[disc_mask(height, width, replace(disc, radius_px=_MIDDLE * disc.radius_px))]
    skewness = (
        float(np.mean(middle**3) / max(float(np.mean(middle**2)), 1e-12) ** 1.5)
        if middle.size
        else 0.0
    )
    return "dark" if skewness > _WHITE_PINS else "bright"


def check_references(
    calibration: Calibration, greys: Sequence[U8], names: Sequence[str] = (), *, allow_loaded: bool
) -> tuple[CalibrationFinding, ...]:
    """Warn of differences between the images of a reference, and of a load if that is allowed.

    Raises FindingError on a load that is not, and on a camera that moved too far.
    """
    names = names or [str(number) for number in range(1, len(greys) + 1)]
    disc, preprocessor = calibration.geometry.disc, Preprocessor(calibration, PROFILE)
    warnings = list[CalibrationFinding]()
    if len(greys) < NOISE_REFERENCES:
        warnings.append(
            finding(
                FindingCode.FEW_REFERENCES,
                found=len(greys),
                expected=ADVISED_REFERENCES,
                noise_grey=ASSUMED_NOISE_GREY,
            )
        )
    # To the first, not to their mean, which a moved image would blur.
    first = camera_drift.look(greys[0], disc, calibration.pitch_px)
    for name, grey in zip(names[1:], greys[1:], strict=True):
        drift = camera_drift.drift(first, grey)
        shift = camera_drift.shift_reason(drift, disc)
        if camera_drift.shifted_too_far(drift, disc):
            raise FindingError(
                finding(FindingCode.CAMERA_MOVED, name=name, change=shift, against=names[0])
            )
        if change := shift or drift.light_reason:
            warnings.append(
                finding(FindingCode.REFERENCES_DIFFER, name=name, change=change, against=names[0])
            )
    loads = _loads(preprocessor, greys, names)
    if loads and not allow_loaded:
        raise FindingError(finding(FindingCode.REFERENCE_PRESSED, load=loads[0]))
    return (*warnings, *loads)


def _loads(
    preprocessor: Preprocessor, greys: Sequence[U8], names: Sequence[str]
) -> list[CalibrationFinding]:
    """What shows a load: in the mean of the references, and in some of them against it."""
    loads = [load] if (load := load_finding(preprocessor)) else []
    gate = ContactGate(preprocessor)
    changed = [gate.changed_part(preprocessor.preprocess(grey)) for grey in greys]
    if pressed := [name for name, part in zip(names, changed, strict=True) if part > LOADED_PART]:
        loads.append(finding(FindingCode.PRESSED_IMAGES, images=pressed))
    return loads


def rezero(
    calibration: Calibration,
    images: Sequence[U8],
    names: Sequence[str] = (),
    *,
    allow_loaded: bool = False,
) -> Calibration:
    """Replace a calibration's reference by new images of the unloaded skin.

    Raises ConfigError if an image cannot be used, the camera moved too far, or something touches
    the skin and that is not allowed.
    """
    if not images:
        raise ConfigError("found no image to take a reference from, expected at least one")
    greys = [greyscale.to_grey(image) for image in images]
    disc = calibration.geometry.disc
    # Against the old reference, so that a covered or blurred lens cannot become the new one.
    judges = plain_judges(calibration, unloaded=True)
    old = camera_drift.look(calibration.reference_grey, disc, calibration.pitch_px)
    refused = [f"rejected reference {name}: " for name in names] or [
        "rejected the reference: "
    ] * len(greys)
    for grey, lead in zip(greys, refused, strict=True):
        if reason := judges.reason(grey):
            raise ConfigError(f"{lead}{reason}")
        drift = camera_drift.drift(old, grey)
        if camera_drift.shifted_too_far(drift, disc):
            shift = camera_drift.shift_reason(drift, disc)
            raise ConfigError(
                f"{lead}{shift}; fasten the camera in its old position, or calibrate again"
            )
        if drift.contrast < _WORN_CONTRAST:
            found = (
                f"found {drift.contrast:.2f} times the old reference's contrast, expected at least "
                f"{_WORN_CONTRAST}"
            )
            raise ConfigError(f"{lead}{found} times; clean or focus the lens, or calibrate again")
    renewed = with_reference(replace(calibration, crc32=0), greys)
    if not allow_loaded and (load := load_finding(Preprocessor(renewed, PROFILE))):
        raise ConfigError(f"rejected the reference: {sentence(load)}")
    return renewed


# An area as large as the gate requires may differ by this much from the origin, less the common
# change: more than an aged lamp causes, less than a lost marker, and far below the gate's least 10,
# so nothing that was followed looks like a contact when it goes. Beyond the common change, frames
# are degraded against the original reference.
PATCH_GREY, COMMON_GREY = 4.0, DRIFT_LEVELS
# A smaller change is not worth a new calibration number (grey levels,
# and multiples of the noise of g).
RENEW_GREY, RENEW_NOISE = 2.0, 2.0


@dataclass(frozen=True, slots=True)
class Distance:
    """The difference between two references: drift, the change of g that all skin shares, the
    greatest beside it on a patch.
    """

    drift: Drift
    common_grey: float
    patch_grey: float


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """The renewed reference (None: the present one stays), the images' distance from the origin
    (None: one cannot be compared), and the bound exceeded or why an image is invalid.
    """

    calibration: Calibration | None
    distance: Distance | None
    reason: Reason | None


def bounds(disc: Disc) -> dict[str, float]:
    """The bounds on each quantity of `Distance`, for messages."""
    return {
        "shift_px": round(camera_drift.SHIFT_PART * disc.radius_px, 3),
        "moved_px": round(camera_drift.RIM_PART * disc.radius_px, 3),
        "light_low": picture.COMPENSATED_LOW,
        "light_high": picture.COMPENSATED_HIGH,
        "uneven": picture.UNEVEN,
        "contrast": picture.CONTRAST,
        "common_grey": COMMON_GREY,
        "patch_grey": PATCH_GREY,
    }


def follow(origin: Calibration, current: Calibration, images: Sequence[U8]) -> Followed:
    """Renew the current reference from untouched images (at least one) within the bounds around the
    origin's. Ageing light changes the image smoothly and hardly affects g; an object that rests on
    the skin, a lost marker or dirt change a patch. The bounds limit the whole change since the
    origin, so that nothing creeps in.
    """
    greys = [greyscale.to_grey(image) for image in images]
    judges = plain_judges(origin, unloaded=True)
    for grey in greys:
        if reason := judges.reason(grey):
            return Followed(None, None, reason)
    # Keep the noise: a sensor that trembles must not raise its own gate.
    renewed = replace(with_reference(replace(origin, crc32=0), greys), noise_grey=origin.noise_grey)
    prepared = Preprocessor(renewed, PROFILE)
    disc = origin.geometry.disc
    drift = camera_drift.drift(
        camera_drift.look(origin.reference_grey, disc, origin.pitch_px), renewed.reference_grey
    )
    distance = Distance(drift, *g_change(Preprocessor(origin, PROFILE), prepared))
    reason = beyond(distance, disc)
    if reason or not _worth(Preprocessor(current, PROFILE), prepared):
        return Followed(None, distance, reason)
    return Followed(renewed, distance, None)


def beyond(distance: Distance, disc: Disc) -> Reason | None:
    """The bound that a reference exceeds; None if it exceeds none."""
    drift = distance.drift
    if drift.still_part == 0:
        return Reason(
            ReasonCode.REFERENCE_INVALID, "the marker pattern differs from the reference's"
        )
    if reason := camera_drift.shift_reason(drift, disc) or drift.light_reason:
        return reason
    if abs(distance.common_grey) > COMMON_GREY:
        text = (
            f"light or focus: the white ratio changed by {distance.common_grey:.0f} levels "
            "everywhere"
        )
        return Reason(ReasonCode.LIGHT_DRIFT, text)
    if distance.patch_grey > PATCH_GREY:
        text = (
            "a resting load, dirt or damage changed a patch of the skin by "
            f"{distance.patch_grey:.1f} grey levels"
        )
        return Reason(ReasonCode.PATCH_CHANGED, text)
    return None


def g_change(old: Preprocessor, new: Preprocessor) -> tuple[float, float]:
    """`Distance.common_grey` and `Distance.patch_grey` between two references of one sensor."""
    g_d = (new.reference_g - old.reference_g)[old.voting].astype(np.float64)
    if not g_d.size:
        return 0.0, 0.0
    # Ageing light moves all cells alike, a load only some: the median is the former.
    common = float(np.median(g_d))
    beside = np.sort(g_d - common)
    least_mm2 = least_area_mm2(GATE_MM2, old.calibration.geometry)
    cells = min(math.ceil(least_mm2 / old.cell_mm2), beside.size)
    return common, max(float(beside[-cells]), -float(beside[cells - 1]), 0.0)


def _worth(current: Preprocessor, renewed: Preprocessor) -> bool:
    """Whether two references differ enough to renew."""
    common, patch = g_change(current, renewed)
    if abs(common) + patch > max(RENEW_GREY, RENEW_NOISE * current.calibration.noise_grey):
        return True
    old, new = (eighth(p.calibration.reference_grey).astype(np.int16) for p in (current, renewed))
    return bool(np.abs(new - old).sum() > RENEW_GREY * old.size)
