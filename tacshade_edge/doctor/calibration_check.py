"""Checks the calibration: is it sound, and does the sensor still look as it did at calibration?"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence

from tacshade_edge import fixes
from tacshade_edge.calibration import loading
from tacshade_edge.calibration.reference import pattern
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.doctor import Finding, Findings, fault, ok, warning
from tacshade_edge.doctor.machine import AS_SERVICE
from tacshade_edge.errors import ConfigError
from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.frame_check import camera_drift
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.settings import Document
from tacshade_edge.types import U8, Calibration, Frame

# Both at once: twice a very small noise is no fault.
_NOISIER, _NOISE_LEVELS = 2.0, 2.0
_NOISE_IMAGES = 3  # of two, the noise would itself be too uncertain to judge
_DAY_S = 86400
_REZERO = (
    "while the daemon is running and nothing is touching the skin, publish {} to "
    "tacshade/SENSOR/req/reference; if the problem returns, calibrate again "
    "(docs/how-to/calibration.md)"
)
_AGED = (
    "restore the light, exposure and focus, or take a new reference: tacshade-edge calibrate "
    "--rezero CAL.npz --reference ref_*.png --out NEW.npz"
)


def load(document: Document) -> tuple[Calibration | None, Findings]:
    """Load the calibration that the settings name (None if it is unusable),
    with findings on its file.
    """
    path = document.settings.calibration
    try:
        calibration = loading.find_calibration(document)
    except ConfigError as error:
        fix = loading.how_to_calibrate(document)
        if os.path.exists(path) and not os.access(path, os.R_OK):
            fix = f"run doctor with sudo, or as the service's user: {AS_SERVICE}"
        return None, (fault("calibration", str(error), fix),)
    if isinstance(calibration, Reason):
        found = (
            f"{document.where('calibration')}: found no file {path}, "
            "so the daemon publishes only pictures"
        )
        return None, (warning("calibration", found, loading.how_to_calibrate(document)),)
    days = (time.time() - os.stat(path).st_mtime) / _DAY_S
    found = f"{path}: {calibration.crc32:08x}, {max(days, 0):.0f} days old"
    if not calibration.factors:
        fix = (
            "take presses (tacshade-edge capture) and calibrate with --presses PRESSES.csv "
            "(docs/how-to/calibration.md)"
        )
        return calibration, (
            warning("calibration", f"{found}; depth is not in true millimetres", fix),
        )
    if renew := loading.fits_to_renew(path):
        fix = "calibrate again with --presses PRESSES.csv --fit (docs/how-to/calibration.md)"
        found += (
            f"; the networks for {', '.join(renew)} have changed since the fit, so the shipped "
            "networks are in use"
        )
        return calibration, (warning("calibration", found, fix),)
    if fitted := calibration.fitted.get(DEFAULT):
        found += f", depth error after the fit {fitted.error_mm:.2f} mm"
    elif accurate := calibration.fit.profiles.get("accurate") if calibration.fit else None:
        found += f", depth error {accurate.depth_mae_mm:.2f} mm"
    return calibration, (ok("calibration", found),)


def check_images(calibration: Calibration, images: Sequence[U8], *, live: bool) -> Findings:
    """Compare images with the calibration's reference;
    nothing should touch the skin in `live` ones, a camera's.
    """
    # The profile that misses the fewest presses.
    reconstructor = make_reconstructor(calibration, PROFILES["accurate"])
    result = reconstructor.step(Frame(0, 0, 0, images[-1]))
    if result.reason:
        return (fault("sensor", f"frames are unusable: {result.reason}", _fix(result.reason)),)
    old = camera_drift.look(
        calibration.reference_grey, calibration.geometry.disc, calibration.pitch_px
    )
    found_drift = camera_drift.drift(old, pattern.mean_image([to_grey(image) for image in images]))
    place = _check_place(calibration, found_drift)
    # A picture from a file may show anything; only a camera is asked to be untouched.
    if not live:
        found = "a touch of unknown depth" if result.touched else "no contact"
        if result.contact:
            found = f"a contact {result.depth_max_mm:.1f} mm deep"
        return (*place, ok("sensor", f"the image matches the calibration and shows {found}"))
    if result.contact:
        found = f"the skin seems to be pressed {result.depth_max_mm:.1f} mm deep"
        found += "; if nothing is touching the skin, the skin has changed"
        return (*place, warning("sensor", found, _REZERO))
    if result.touched:
        found = "something seems to touch the skin, but its depth is unknown"
        found += "; if nothing is touching it, the skin has changed"
        return (*place, warning("sensor", found, _REZERO))
    if result.degraded:
        return (*place, warning("sensor", result.degraded.text, _fix(result.degraded)))
    # A camera that has moved explains everything below, which would send a person the wrong way.
    if camera_drift.shifted_too_far(found_drift, calibration.geometry.disc):
        return place
    if change := found_drift.light_reason:
        return (*place, warning("sensor", f"{change} since the calibration", _AGED))
    return (*place, _check_noise(calibration, images))


def _check_place(calibration: Calibration, found: camera_drift.Drift) -> Findings:
    """Judge whether the visible circle has moved; no finding if that cannot be seen
    (a contact may hide it).
    """
    # Nothing holds still: a contact covers the circle, or this is another sensor.
    if found.still_part == 0:
        return ()
    size = f"changed size by {100 * (found.zoom - 1):+.1f} %"
    place = f"the visible circle has moved {found.shift_px:.1f} px and {size} since the calibration"
    if camera_drift.shifted_too_far(found, calibration.geometry.disc):
        fix = (
            "the camera has moved inside the sensor; move it back, or calibrate again "
            "(docs/how-to/calibration.md)"
        )
        return (warning("camera place", place, fix),)
    return (ok("camera place", place),)


def _check_noise(calibration: Calibration, images: Sequence[U8]) -> Finding:
    try:
        # As `calibrate --rezero` would, which is also the fix that is suggested.
        renewed = rezero(calibration, images)
    except ConfigError as error:
        return warning("sensor", str(error), "lift the sensor off the object; " + _REZERO)
    noise = (
        f"noise of {renewed.noise_grey:.2f} grey levels, compared with "
        f"{calibration.noise_grey:.2f} at calibration"
    )
    if len(images) < _NOISE_IMAGES:
        noise = "one image"
    elif renewed.noise_grey > max(_NOISE_LEVELS, _NOISIER * calibration.noise_grey):
        fix = (
            "replace flickering light (mains lamps flicker), stop whatever is shaking the sensor, "
            "and calibrate again"
        )
        return warning("sensor", noise, fix)
    return ok("sensor", f"the image matches the calibration and shows no contact, {noise}")


def _fix(reason: Reason) -> str:
    return fixes.OF_FRAMES.get(reason.code, _REZERO)
