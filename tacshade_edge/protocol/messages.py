"""What the daemon publishes as JSON of a frame and of itself: `topics` has the types."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from tacshade_edge.protocol.codec import encode_json
from tacshade_edge.protocol.topics import Contact, Info, InfoGeometry, SlipEvent, TouchNumbers
from tacshade_edge.protocol.wire import WIRE_VERSION
from tacshade_edge.reasons import Reason, code_of, reason_fields
from tacshade_edge.types import Calibration, Reconstruction, Touch, TouchedObject
from tacshade_edge.types.reconstruction import QUANTITIES

# Everything except the reason may be null, which the viewers' JSON Schema cannot express.
TOUCH_SCHEMA: Mapping[str, Any] = {
    "title": "tacshade.Touch",
    "type": "object",
    "properties": {
        **{name: {"type": "number"} for name in ("t_ns", "seq", "wall_ns")},
        **{
            name: {"type": "object", "properties": {each: {"type": "number"} for each in QUANTITIES}}
            for name in ("touch", "touch_sigma")
        },
        **{name: {"type": "string"} for name in ("reason", "reason_code")},
    },
}
"""JSON Schema of ``touch``, for viewers."""


def encode_contact(result: Reconstruction, *, fps: float) -> bytes:
    """The ``contact`` payload; `fps` is the delivery rate in 1/s."""
    x_mm, y_mm = result.objects[0].centroid_mm[:2] if result.objects else (None, None)
    shears = [o.shear_mm for o in result.objects if o.shear_mm is not None]
    shear_x_mm, shear_y_mm = max(shears, key=lambda x_y: math.hypot(*x_y), default=(None, None))
    slips = [(o.slip, o.slip_mm_s or 0.0) for o in result.objects if o.slip is not None]
    slip, slip_mm_s = max(slips, default=(None, None))
    return encode_json(
        Contact(
            t_ns=result.t_ns,
            seq=result.seq,
            contact=int(result.contact),
            depth_max_mm=result.depth_max_mm,
            area_mm2=sum((o.area_mm2 for o in result.objects), 0.0),
            volume_mm3=result.volume_mm3,
            objects=len(result.objects),
            x_mm=x_mm,
            y_mm=y_mm,
            shear_x_mm=shear_x_mm,
            shear_y_mm=shear_y_mm,
            twist_deg=max((o.twist_deg for o in result.objects if o.twist_deg is not None), key=abs, default=None),
            slip=slip,
            slip_mm_s=slip_mm_s,
            fps=fps,
            reason_code=code_of(result.reason),
            degraded_code=code_of(result.degraded),
            wall_ns=result.wall_ns,
        )
    )


def encode_touch(result: Reconstruction) -> bytes:
    """The ``touch`` payload."""
    reason = result.reason if result.touch is None else result.touch.reason
    fields: dict[str, Any] = {**touch_fields(result.touch), **reason_fields(reason)}
    return encode_json(TouchNumbers(t_ns=result.t_ns, seq=result.seq, wall_ns=result.wall_ns, **fields))


def touch_fields(touch: Touch | None) -> dict[str, Any]:
    """Fields ``touch`` and ``touch_sigma`` of messages and ``summary.json``, rounded to 0.0001; None without touch."""
    if touch is None:
        return {"touch": None, "touch_sigma": None}
    return {"touch": _rounded(touch.values), "touch_sigma": _rounded(touch.sigma)}


def _rounded(values: Mapping[str, float | None]) -> dict[str, float | None]:
    return {name: None if value is None else round(value, 4) for name, value in values.items()}


def encode_slip(result: Reconstruction, sliding: TouchedObject) -> bytes:
    """The ``event/slip`` payload of an object that began to slide."""
    x_mm, y_mm, _ = sliding.centroid_mm
    slip = SlipEvent(t_ns=result.t_ns, seq=result.seq, id=sliding.id, x_mm=x_mm, y_mm=y_mm, slip_mm_s=sliding.slip_mm_s)
    return encode_json(slip)


def encode_info(
    *,
    version: str,
    config_digest: str,
    profile: str,
    calibration: Calibration | Reason,
    profiles: Sequence[str] = (),
    choice: str | None = None,
    reference: Mapping[str, Any] | None = None,
    hand_id: str | None = None,
    hand_T_sensor: Sequence[float] | None = None,
) -> bytes:
    """The ``info`` payload; `calibration` is the reason if there is none, a missing `choice` means `profile`."""
    missing, known = (calibration, None) if isinstance(calibration, Reason) else (None, calibration)
    return encode_json(
        Info(
            version=version,
            wire_version=WIRE_VERSION,
            config_digest=config_digest,
            profile=profile,
            profiles=tuple(profiles),
            choice=choice or profile,
            reference=None if reference is None else dict(reference),
            geometry=_geometry(known) if known else None,
            fitted=tuple(sorted(known.fitted)) if known else (),
            hand_id=hand_id,
            hand_T_sensor=None if hand_T_sensor is None else tuple(hand_T_sensor),  # type: ignore[arg-type]
            **reason_fields(missing),
        )
    )


def _geometry(calibration: Calibration) -> InfoGeometry:
    geometry = calibration.geometry
    return InfoGeometry(
        skin_radius_mm=geometry.skin_radius_mm,
        camera_distance_mm=geometry.camera_distance_mm,
        visible_half_angle_deg=geometry.visible_half_angle_deg,
        f_px=geometry.f_px,
        mm_per_px=geometry.mm_per_px,
        row_c=geometry.disc.row_c,
        col_c=geometry.disc.col_c,
        radius_px=geometry.disc.radius_px,
        image_height_px=calibration.image_height_px,
        image_width_px=calibration.image_width_px,
        flange_T_sensor=calibration.flange_T_sensor,  # type: ignore[arg-type]
        calibration_crc32=calibration.crc32,
    )


def encode_status(
    state: str, reason: Reason | None = None, details: Mapping[str, str | int | float] | None = None
) -> bytes:
    """The ``status/<part>`` payload: ``state``, ``reason`` with its code, and the part's own details."""
    return encode_json({**(details or {}), "state": state, **reason_fields(reason)})
