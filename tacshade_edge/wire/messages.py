"""What the daemon publishes as JSON of a frame and of itself: `topics` has the types."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from tacshade_edge.reasons import Reason, code_of, reason_fields
from tacshade_edge.types import QUANTITIES, Calibration, Reconstruction, Touch, TouchedObject
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.sensor_topics import (
    Contact,
    Info,
    InfoGeometry,
    ObjectEvent,
    SlipEvent,
    TouchNumbers,
)
from tacshade_edge.wire.wire_format import WIRE_VERSION

# Everything except the reason may be null, which the viewers' JSON Schema cannot express.
TOUCH_SCHEMA: Mapping[str, Any] = {
    "title": "tacshade.Touch",
    "type": "object",
    "properties": {
        **{name: {"type": "number"} for name in ("t_ns", "seq", "wall_ns")},
        **{
            name: {
                "type": "object",
                "properties": {each: {"type": "number"} for each in QUANTITIES},
            }
            for name in ("touch", "touch_sigma")
        },
        **{name: {"type": "string"} for name in ("reason", "reason_code")},
    },
}
"""JSON Schema of ``touch``, for viewers."""


def encode_contact(result: Reconstruction, *, fps: float) -> bytes:
    """The ``contact`` payload; `fps` is the delivery rate in 1/s."""
    # Objects are sorted: the largest comes first.
    x_mm, y_mm = result.objects[0].centroid_mm[:2] if result.objects else (None, None)
    shears = [o.shear_mm for o in result.objects if o.shear_mm is not None]
    shear_x_mm, shear_y_mm = max(shears, key=lambda x_y: math.hypot(*x_y), default=(None, None))
    slips = [(o.slip, o.slip_mm_s or 0.0) for o in result.objects if o.slip is not None]
    # By slip first, then by speed: the pair is of one object.
    slip, slip_mm_s = max(slips, default=(None, None))
    # A 0 would say that nothing is pressed in, or touches, which nobody knows.
    known = result.valid and not result.touched
    return encode_json(
        Contact(
            t_ns=result.t_ns,
            seq=result.seq,
            contact=int(result.contact) if result.valid else None,
            depth_max_mm=result.depth_max_mm if known else None,
            area_mm2=sum((o.area_mm2 for o in result.objects), 0.0) if known else None,
            volume_mm3=result.volume_mm3 if known else None,
            objects=len(result.objects) if result.valid else None,
            x_mm=x_mm,
            y_mm=y_mm,
            shear_x_mm=shear_x_mm,
            shear_y_mm=shear_y_mm,
            twist_deg=max(
                (o.twist_deg for o in result.objects if o.twist_deg is not None),
                key=abs,
                default=None,
            ),
            slip=slip,
            slip_mm_s=slip_mm_s,
            fps=fps,
            reason_code=code_of(result.reason),
            degraded_code=code_of(result.degraded),
            wall_ns=result.wall_ns,
            touched=int(result.touched) if result.valid else None,
        )
    )


def encode_touch(result: Reconstruction) -> bytes:
    """The ``touch`` payload."""
    # A touch of unknown depth is a valid frame, so its reason is among the degraded ones.
    missing = result.degraded if result.touched else result.reason
    reason = missing if result.touch is None else result.touch.reason
    numbers: dict[str, Any] = {**touch_fields(result.touch), **reason_fields(reason)}
    return encode_json(
        TouchNumbers(t_ns=result.t_ns, seq=result.seq, wall_ns=result.wall_ns, **numbers)
    )


def touch_fields(touch: Touch | None) -> dict[str, Any]:
    """Fields ``touch`` and ``touch_sigma`` of messages and ``summary.json``, rounded to 0.0001;
    None without touch.
    """
    if touch is None:
        return {"touch": None, "touch_sigma": None}
    return {"touch": _rounded(touch.values), "touch_sigma": _rounded(touch.sigma)}


def _rounded(values: Mapping[str, float | None]) -> dict[str, float | None]:
    return {name: None if value is None else round(value, 4) for name, value in values.items()}


def encode_slip(result: Reconstruction, sliding: TouchedObject) -> bytes:
    """The ``event/slip`` payload of an object that began to slide."""
    x_mm, y_mm, _ = sliding.centroid_mm
    slip = SlipEvent(
        t_ns=result.t_ns,
        seq=result.seq,
        id=sliding.id,
        x_mm=x_mm,
        y_mm=y_mm,
        slip_mm_s=sliding.slip_mm_s,
    )
    return encode_json(slip)


def encode_object(result: Reconstruction, named: TouchedObject) -> bytes:
    """The ``event/object`` payload of an object that has a name."""
    assert named.name is not None
    assert named.probability is not None
    event = ObjectEvent(
        name=named.name,
        probability=round(named.probability, 3),
        label=named.label,
        t_ns=result.t_ns,
        seq=result.seq,
        wall_ns=result.wall_ns,
    )
    return encode_json(event)


def event_values(result: Reconstruction) -> dict[str, float]:
    """The values of a frame whose greatest a `ContactEvent` has."""
    # Left out if unknown: None would not compare with the greatest so far.
    shear, slips = (
        result.shear_of_contact_mm,
        [o.slip for o in result.objects if o.slip is not None],
    )
    values = {
        "depth_max_mm": result.depth_max_mm,
        "volume_mm3": result.volume_mm3,
        "objects": len(result.objects),
    }
    return (
        values
        | ({"shear_mm": math.hypot(*shear)} if shear else {})
        | ({"slip": max(slips)} if slips else {})
    )


def encode_info(
    *, calibration: Calibration | Reason, choice: str | None = None, profile: str, **others: Any
) -> bytes:
    """The ``info`` payload; `calibration` is the reason if there is none,
    a missing `choice` means `profile`.

    `others` are fields of `Info`.
    """
    missing, known = (calibration, None) if isinstance(calibration, Reason) else (None, calibration)
    others |= reason_fields(missing)
    info = Info(
        wire_version=WIRE_VERSION,
        profile=profile,
        choice=choice or profile,
        geometry=_geometry(known) if known else None,
        fitted=tuple(sorted(known.fitted)) if known else (),
        **others,
    )
    return encode_json(info)


def _geometry(calibration: Calibration) -> InfoGeometry:
    sources = calibration, calibration.geometry, calibration.geometry.disc
    # By name: what `info` reports of the calibration has the calibration's names.
    names = {field.name for field in fields(InfoGeometry)}
    values = {
        name: getattr(source, name) for source in sources for name in names if hasattr(source, name)
    }
    # A pad's radius is infinite, which JSON lacks.
    if calibration.geometry.skin == "pad":
        values |= {"skin_radius_mm": None, "visible_half_angle_deg": None}
    return InfoGeometry(**values, calibration_crc32=calibration.crc32)


def encode_status(
    state: str, reason: Reason | None = None, details: Mapping[str, str | int | float] | None = None
) -> bytes:
    """The ``status/<part>`` payload: ``state``, ``reason`` with its code,
    and the part's own details.
    """
    # A part's own details cannot replace its state or reason, which come last.
    return encode_json({**(details or {}), "state": state, **reason_fields(reason)})
