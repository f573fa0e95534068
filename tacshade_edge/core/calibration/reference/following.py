"""Renew the reference while nothing touches, to follow slow change of the image within bounds around the origin: the
calibration's own reference, or the latest one requested.

A light ages, a lens warms up, dust settles: such change is smooth and hardly affects g. An object that rests on the
skin, a lost marker or dirt changes a patch. An object laid on so gently that the gate stays closed is such a patch too,
so the bounds limit the whole change since the origin, not each renewal.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from tacshade_edge.core.calibration.reference.references import PROFILE, with_reference
from tacshade_edge.core.contact.gate import GATE_MM2
from tacshade_edge.core.frame_check import camera, light, plain_judges
from tacshade_edge.core.frame_check.camera import Drift
from tacshade_edge.core.frame_check.light import DRIFT_LEVELS
from tacshade_edge.core.image import greyscale
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Calibration, Disc

# An area as large as the gate requires may differ by this much from the origin, less the common change: more than an
# aged lamp causes, less than a lost marker. It is far below the gate's least 10, so nothing that was followed looks
# like a contact when it goes. The tests state how much later a slow load is found because of it.
PATCH_GREY = 4.0
# Limit of the common change: beyond it, frames are degraded against the original reference.
COMMON_GREY = DRIFT_LEVELS
# A smaller change is not worth a new calibration number (grey levels, and multiples of the noise of g).
RENEW_GREY, RENEW_NOISE = 2.0, 2.0
_BLOCK_PX = 8  # averages the noise of single pixels


@dataclass(frozen=True, slots=True)
class Distance:
    """The difference between two references: their drift, the change of g that the whole skin shares, and the greatest
    difference from that over `GATE_MM2` of skin, lighter or darker.
    """

    drift: Drift
    common_grey: float
    patch_grey: float


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """The result of `follow`: the calibration with the renewed reference (None: the present one stays), the distance of
    the images from the origin (None: one cannot be compared), and the bound exceeded or why an image is invalid.
    """

    calibration: Calibration | None
    distance: Distance | None
    reason: Reason | None


def bounds(disc: Disc) -> dict[str, float]:
    """The bounds on each quantity of `Distance`, for messages."""
    return {
        "shift_px": round(camera.SHIFT_PART * disc.radius_px, 3),
        "moved_px": round(camera.RIM_PART * disc.radius_px, 3),
        "light_low": light.COMPENSATED_LOW,
        "light_high": light.COMPENSATED_HIGH,
        "uneven": light.UNEVEN,
        "contrast": light.CONTRAST,
        "common_grey": COMMON_GREY,
        "patch_grey": PATCH_GREY,
    }


def follow(origin: Calibration, current: Calibration, images: Sequence[U8]) -> Followed:
    """Renew the current reference from untouched images (at least one) if they are within the bounds around the
    origin's.
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
    drift = camera.drift(camera.look(origin.reference_grey, disc, origin.pitch_px), renewed.reference_grey)
    distance = Distance(drift, *g_change(Preprocessor(origin, PROFILE), prepared))
    reason = beyond(distance, disc)
    if reason or not _worth(Preprocessor(current, PROFILE), prepared):
        return Followed(None, distance, reason)
    return Followed(renewed, distance, None)


def beyond(distance: Distance, disc: Disc) -> Reason | None:
    """The bound that a reference exceeds; None if it exceeds none."""
    drift = distance.drift
    if drift.still_part == 0:
        return Reason(ReasonCode.REFERENCE_INVALID, "the marker pattern differs from the reference's")
    if reason := camera.shift_reason(drift, disc) or drift.light_reason:
        return reason
    if abs(distance.common_grey) > COMMON_GREY:
        text = f"light or focus: the white ratio changed by {distance.common_grey:.0f} levels everywhere"
        return Reason(ReasonCode.LIGHT_DRIFT, text)
    if distance.patch_grey > PATCH_GREY:
        text = f"a resting load, dirt or damage changed a patch of the skin by {distance.patch_grey:.1f} grey levels"
        return Reason(ReasonCode.PATCH_CHANGED, text)
    return None


def g_change(old: Preprocessor, new: Preprocessor) -> tuple[float, float]:
    """`Distance.common_grey` and `Distance.patch_grey` between two references of one sensor."""
    g_d = (new.reference_g - old.reference_g)[old.voting].astype(np.float64)
    if not g_d.size:
        return 0.0, 0.0
    common = float(np.median(g_d))
    beside = np.sort(g_d - common)
    cells = min(math.ceil(GATE_MM2 / old.cell_mm2), beside.size)
    return common, max(float(beside[-cells]), -float(beside[cells - 1]), 0.0)


def _worth(current: Preprocessor, renewed: Preprocessor) -> bool:
    """Whether two references differ enough to renew."""
    common, patch = g_change(current, renewed)
    if abs(common) + patch > max(RENEW_GREY, RENEW_NOISE * current.calibration.noise_grey):
        return True
    size = tuple(math.ceil(side / _BLOCK_PX) for side in current.calibration.reference_grey.shape[::-1])
    old, new = (
        cv2.resize(np.asarray(p.calibration.reference_grey), size, interpolation=cv2.INTER_AREA)
        for p in (current, renewed)
    )
    return bool(np.mean(cv2.absdiff(old, new)) > RENEW_GREY)
