"""The JSON payloads: ``contact``, ``info``, ``status/<part>``, ``health``, and ``req/<verb>`` with its ``res/<verb>``.

JSON has no NaN and no infinity: both are written as null.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.results import NoSession, ReferenceTaken, RequestResult, SessionEnded, SessionStatus
from tacshade_edge.protocol.serial.answers import error_word
from tacshade_edge.protocol.wire import WIRE_VERSION
from tacshade_edge.quoting import escaped
from tacshade_edge.reasons import Reason, ReasonCode, code_of, reason_fields
from tacshade_edge.types import Calibration, Reconstruction, TouchedObject

Verb = Literal["reference", "profile", "status", "record", "stitch", "replay"]
StitchAction = Literal["begin", "add", "end", "abort", "status"]
Transaction = Annotated[str, msgspec.Meta(max_length=128)] | Annotated[int, msgspec.Meta(ge=-(2**53), le=2**53)] | None
REQUEST_BYTES_MAX: Final = 4096
RECORD_S_MAX: Final = 3600  # 40 GB of grey 640x480 at 60 per second
RECORD_NAME: Final = r"\A[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}\Z"
RECORD_NAME_RULE: Final = "up to 64 letters, digits, '.', '_' and '-', not a dot first"
_ERROR_CHARS_MAX: Final = 200


class _Reference(msgspec.Struct, forbid_unknown_fields=True):
    transaction: Transaction = None


class _Profile(msgspec.Struct, forbid_unknown_fields=True):
    profile: Annotated[str, msgspec.Meta(min_length=1, max_length=128)]
    transaction: Transaction = None


class _Status(msgspec.Struct, forbid_unknown_fields=True):
    transaction: Transaction = None


RecordingFormat = Literal["folder", "mcap"]


class _RecordStart(msgspec.Struct, forbid_unknown_fields=True, tag_field="action", tag="start"):
    seconds: Annotated[float, msgspec.Meta(gt=0, le=RECORD_S_MAX)]
    name: Annotated[str, msgspec.Meta(pattern=RECORD_NAME)] | None = None
    format: RecordingFormat = "folder"
    transaction: Transaction = None


class _RecordStop(msgspec.Struct, forbid_unknown_fields=True, tag_field="action", tag="stop"):
    transaction: Transaction = None


class _RecordMark(msgspec.Struct, forbid_unknown_fields=True, tag_field="action", tag="mark"):
    text: Annotated[str, msgspec.Meta(max_length=200)] = ""
    transaction: Transaction = None


class _Stitch(msgspec.Struct, forbid_unknown_fields=True):
    action: StitchAction
    name: Annotated[str, msgspec.Meta(min_length=1, max_length=128)] | None = None
    transaction: Transaction = None

    def __post_init__(self) -> None:
        if self.name is not None and self.action != "begin":
            raise ValueError(f"found a name with the action {self.action}")


class _Replay(msgspec.Struct, forbid_unknown_fields=True):
    paused: bool | None = None
    step: bool = False
    back: bool = False
    seek_s: Annotated[float, msgspec.Meta(ge=0, le=1e9)] | None = None
    speed: Annotated[float, msgspec.Meta(ge=0.01, le=100)] | None = None
    transaction: Transaction = None


class _Echo(msgspec.Struct):
    transaction: Transaction = None


_BODIES: Final[dict[Verb, Any]] = {
    "reference": _Reference,
    "profile": _Profile,
    "status": _Status,
    "record": _RecordStart | _RecordStop | _RecordMark,
    "stitch": _Stitch,
    "replay": _Replay,
}
_KEYS: Final[dict[Verb, str]] = {
    "profile": '"profile": NAME, ',
    "record": f'"action": "start", "seconds": NUMBER up to {RECORD_S_MAX}, "name": {RECORD_NAME_RULE} (optional), '
    '"format": "folder" or "mcap" (optional), or "action": "mark", "text": TEXT (optional), or "action": "stop", ',
    "stitch": '"action": "begin", "name": TEXT (optional), or "action": "add", "end", "abort" or "status", ',
    "replay": '"paused": true or false, "step": true, "back": true, "seek_s": NUMBER, "speed": 0.01 to 100 '
    "(each optional), ",
}


@dataclass(frozen=True, slots=True)
class PlaybackCommand:
    """What ``req/replay`` asks of a recording that is played; None leaves as it is.

    Attributes
    ----------
    paused : bool or None
    step : bool
        One frame more, and a pause.
    back : bool
        The frame before the one that is shown, and a pause.
    seek_s : float or None
        Go to this time after the first frame.
    speed : float or None
        Times the recording's pace.
    """

    paused: bool | None = None
    step: bool = False
    back: bool = False
    seek_s: float | None = None
    speed: float | None = None


@dataclass(frozen=True, slots=True)
class Request:
    """One command from ``req/<verb>``.

    Attributes
    ----------
    verb : str
        ``reference`` (take a new reference now), ``profile`` (change to `profile`), ``status`` (report),
        ``record`` (start, mark or stop a recording), ``stitch`` (a stitching session),
        ``replay`` (to a recording that is played).
    transaction : str, int or None
        The caller's own mark, given back in the reply.
    profile : str
        Empty unless the verb is ``profile``.
    action : str
        ``start``, ``mark`` or ``stop`` of the verb ``record``, a `StitchAction` of ``stitch``, else empty.
    name : str
        Of the recording to start or the session to begin; empty is for the daemon to choose.
    seconds : float
        How long it shall be.
    text : str
        What to write beside a mark; may be empty.
    playback : PlaybackCommand or None
        Of the verb ``replay``.
    format : str
        Of the frames in the recording: a folder of images with their table, or MCAP files.
    response_topic : str or None
        MQTT 5: where the caller wants the reply, ``res/...`` below the sensor's topics; None is ``res/<verb>``.
    correlation : bytes or None
        MQTT 5: correlation data, given back with the reply.
    """

    verb: Verb
    transaction: str | int | None = None
    profile: str = ""
    response_topic: str | None = None
    correlation: bytes | None = None
    action: Literal["", "start", "mark", "stop"] | StitchAction = ""
    name: str = ""
    seconds: float = 0.0
    text: str = ""
    playback: PlaybackCommand | None = None
    format: RecordingFormat = "folder"


def parse_request(
    verb: str, payload: bytes, *, response_topic: str | None = None, correlation: bytes | None = None
) -> Request:
    """Understand the payload of ``req/<verb>``; an empty one means ``{}``.

    Raises
    ------
    DecodeError
        Unknown verb, not JSON, unknown or missing key, wrong type, longer than 4096 bytes.
    """
    known = next((v for v in _BODIES if v == verb), None)
    if known is None:
        found = f"req/{escaped(verb, _ERROR_CHARS_MAX)}: unknown verb, expected one of {', '.join(_BODIES)}"
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST)
    if len(payload) > REQUEST_BYTES_MAX:
        found = f"req/{verb}: {len(payload)} bytes, expected at most {REQUEST_BYTES_MAX}"
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST)
    try:
        body = msgspec.json.decode(payload or b"{}", type=_BODIES[known])
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        found = f"req/{verb}: {escaped(str(error), _ERROR_CHARS_MAX)}; expected {_expected(known)}"
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST) from error
    request = Request(known, body.transaction, response_topic=response_topic, correlation=correlation)
    if isinstance(body, _Profile):
        return replace(request, profile=body.profile)
    if isinstance(body, _RecordStart):
        return replace(request, action="start", name=body.name or "", seconds=body.seconds, format=body.format)
    if isinstance(body, _Replay):
        return replace(request, playback=PlaybackCommand(body.paused, body.step, body.back, body.seek_s, body.speed))
    if isinstance(body, _RecordMark):
        return replace(request, action="mark", text=body.text)
    if isinstance(body, _Stitch):
        return replace(request, action=body.action, name=body.name or "")
    return replace(request, action="stop") if isinstance(body, _RecordStop) else request


def parse_transaction(payload: bytes) -> str | int | None:
    """The ``transaction`` of a request that `parse_request` refused, so that the error can echo it, or None."""
    try:
        return msgspec.json.decode(payload[:REQUEST_BYTES_MAX], type=_Echo).transaction
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def encode_result(transaction: str | int | None, result: RequestResult | Mapping[str, Any]) -> bytes:
    """The reply to a request that was done: ``{"transaction", "ok": true, "result": {...}}``."""
    return _encode({"transaction": transaction, "ok": True, "result": _result_json(result)})


def encode_error(transaction: str | int | None, reason: Reason) -> bytes:
    """The reply to a request that was refused or failed.

    ``{"transaction", "ok": false, "error": "one line", "reason_code"}``.
    """
    return _encode({"transaction": transaction, "ok": False, "error": reason.text, "reason_code": reason.code})


def encode_reply(request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> bytes:
    """The reply to a request; the error of ``stitch`` begins with the serial line's word for its code."""
    if not isinstance(outcome, Reason):
        return encode_result(request.transaction, outcome)
    if request.verb != "stitch":
        return encode_error(request.transaction, outcome)
    error = f"{error_word(outcome.code)}: {outcome.text}"
    return _encode({"transaction": request.transaction, "ok": False, "error": error, "reason_code": outcome.code})


def encode_contact(result: Reconstruction, *, fps: float) -> bytes:
    """The ``contact`` payload: flat numbers, and codes of `reasons.ReasonCode`, empty when all is well.

    ``contact`` is 0 or 1, ``objects`` a count, ``area_mm2`` their sum; ``x_mm`` and ``y_mm`` are the centroid
    of the greatest object and null without one, since 0 is a place. Shear, twist and slip (0 stick, 1 partial, 2
    full) are of the object that has the most of each, null where there is none. `fps` is the rate of delivery in 1/s.
    `t_ns` and `wall_ns` are of the capture, on the daemon's monotonic clock and in Unix time.
    """
    x_mm, y_mm = result.objects[0].centroid_mm[:2] if result.objects else (None, None)
    shears = [o.shear_mm for o in result.objects if o.shear_mm is not None]
    shear_x_mm, shear_y_mm = max(shears, key=lambda x_y: math.hypot(*x_y), default=(None, None))
    slips = [(o.slip, o.slip_mm_s or 0.0) for o in result.objects if o.slip is not None]
    slip, slip_mm_s = max(slips, default=(None, None))
    return _encode(
        {
            "t_ns": result.t_ns,
            "seq": result.seq,
            "contact": int(result.contact),
            "depth_max_mm": result.depth_max_mm,
            "area_mm2": sum((o.area_mm2 for o in result.objects), 0.0),
            "volume_mm3": result.volume_mm3,
            "objects": len(result.objects),
            "x_mm": x_mm,
            "y_mm": y_mm,
            "shear_x_mm": shear_x_mm,
            "shear_y_mm": shear_y_mm,
            "twist_deg": max((o.twist_deg for o in result.objects if o.twist_deg is not None), key=abs, default=None),
            "slip": slip,
            "slip_mm_s": slip_mm_s,
            "fps": fps,
            "reason_code": code_of(result.reason),
            "degraded_code": code_of(result.degraded),
            "wall_ns": result.wall_ns,
        }
    )


def encode_slip(result: Reconstruction, sliding: TouchedObject) -> bytes:
    """The ``event/slip`` payload: which object began to slide, when, where and how fast over the skin."""
    x_mm, y_mm, _ = sliding.centroid_mm
    return _encode(
        {
            "t_ns": result.t_ns,
            "seq": result.seq,
            "id": sliding.id,
            "x_mm": x_mm,
            "y_mm": y_mm,
            "slip_mm_s": sliding.slip_mm_s,
        }
    )


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
    """The ``info`` payload: what a subscriber needs to place every pixel of ``height`` in mm.

    `calibration` is why there is none, where there is none: ``geometry`` is null then.

    `profiles` are the names that ``req/profile`` takes; empty where it takes none. `choice` is that of them which was
    chosen: `profile` where it is None. `reference` is where the reference began and how far it may follow from there;
    None where it does not follow. `hand_id` is of the hand that the sensor is a finger of, `hand_T_sensor` (x, y, z
    in mm, quaternion w, x, y, z) where it is there; None without a hand.
    """
    missing, known = (calibration, None) if isinstance(calibration, Reason) else (None, calibration)
    return _encode(
        {
            "version": version,
            "wire_version": WIRE_VERSION,
            "config_digest": config_digest,
            "profile": profile,
            "profiles": profiles,
            "choice": choice or profile,
            "reference": reference,
            "geometry": _geometry_json(known) if known else None,
            "hand_id": hand_id,
            "hand_T_sensor": hand_T_sensor,
            **reason_fields(missing),
        }
    )


def _geometry_json(calibration: Calibration) -> dict[str, object]:
    geometry = calibration.geometry
    return {
        "skin_radius_mm": geometry.skin_radius_mm,
        "camera_distance_mm": geometry.camera_distance_mm,
        "visible_half_angle_deg": geometry.visible_half_angle_deg,
        "f_px": geometry.f_px,
        "mm_per_px": geometry.mm_per_px,
        "row_c": geometry.disc.row_c,
        "col_c": geometry.disc.col_c,
        "radius_px": geometry.disc.radius_px,
        "image_height_px": calibration.image_height_px,
        "image_width_px": calibration.image_width_px,
        "flange_T_sensor": calibration.flange_T_sensor,
        "calibration_crc32": calibration.crc32,
    }


def encode_status(
    state: str, reason: Reason | None = None, details: Mapping[str, str | int | float] | None = None
) -> bytes:
    """The ``status/<part>`` payload: ``state``, ``reason`` with its code, and the part's own details."""
    return _encode({**(details or {}), "state": state, **reason_fields(reason)})


def encode_map(about: Mapping[str, str | int | float | None]) -> bytes:
    """The ``map/revision`` and ``map/final`` payloads: flat."""
    return _encode(about)


def encode_health(health: Mapping[str, Any]) -> bytes:
    """The ``health`` payload: the daemon's counters and rates as they are."""
    return _encode(health)


def _result_json(result: RequestResult | Mapping[str, Any]) -> object:
    """Numbers as on the serial line."""
    match result:
        case SessionEnded():
            rounded = {"disagreement_mm": round(result.disagreement_mm, 3), "area_mm2": round(result.area_mm2)}
            return {**asdict(result), "refined": int(result.refined), **rounded}
        case SessionStatus():
            return {"open": 1, **asdict(result)}
        case NoSession():
            return {"open": 0}
        case ReferenceTaken():
            figures = {key: value for key, value in asdict(result).items() if key != "unstored"}
            return {**figures, "stored": result.unstored is None, **reason_fields(result.unstored)}
        case _:
            return result


def _encode(value: object) -> bytes:
    return msgspec.json.encode(value, enc_hook=_plain)


def _plain(value: object) -> object:
    """A number of numpy's as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} has no JSON form here")


def _expected(verb: Verb) -> str:
    return f'a JSON object {{{_KEYS.get(verb, "")}"transaction": TEXT or INTEGER}}, transaction optional'
