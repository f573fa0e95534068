"""Decode the JSON payloads of ``req/<verb>`` strictly."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal

import msgspec

from tacshade_edge.errors import DecodeError
from tacshade_edge.quoting import escaped
from tacshade_edge.reasons import ReasonCode

Verb = Literal["reference", "profile", "status", "record", "stitch", "replay"]
StitchAction = Literal["begin", "add", "end", "abort", "status"]
Transaction = Annotated[str, msgspec.Meta(max_length=128)] | Annotated[int, msgspec.Meta(ge=-(2**53), le=2**53)] | None
REQUEST_BYTES_MAX: Final = 4096
RECORD_S_MAX: Final = 3600  # 40 GB of grey 640x480 at 60 per second
RECORD_NAME: Final = r"\A[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}\Z"
"""Also for a stitching session: recordings and sessions name their folders."""
RECORD_NAME_RULE: Final = "up to 64 letters, digits, '.', '_' and '-', not starting with '.'"
_ERROR_CHARS_MAX: Final = 200


class _Body(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    transaction: Transaction = None


class _Profile(_Body):
    profile: Annotated[str, msgspec.Meta(min_length=1, max_length=128)]


RecordingFormat = Literal["folder", "mcap"]


class _RecordStart(_Body, tag_field="action", tag="start"):
    seconds: Annotated[float, msgspec.Meta(gt=0, le=RECORD_S_MAX)]
    name: Annotated[str, msgspec.Meta(pattern=RECORD_NAME)] | None = None
    format: RecordingFormat = "folder"


class _RecordStop(_Body, tag_field="action", tag="stop"):
    pass


class _RecordMark(_Body, tag_field="action", tag="mark"):
    text: Annotated[str, msgspec.Meta(max_length=200)] = ""


class _Stitch(_Body):
    action: StitchAction
    name: Annotated[str, msgspec.Meta(pattern=RECORD_NAME)] | None = None

    def __post_init__(self) -> None:
        if self.name is not None and self.action != "begin":
            raise ValueError(f"found a name with the action {self.action}")


class _Replay(_Body):
    paused: bool | None = None
    step: bool = False
    back: bool = False
    seek_s: Annotated[float, msgspec.Meta(ge=0, le=1e9)] | None = None
    speed: Annotated[float, msgspec.Meta(ge=0.01, le=100)] | None = None


class _Echo(msgspec.Struct):
    transaction: Transaction = None


_BODIES: Final[dict[Verb, Any]] = {
    "reference": _Body,
    "profile": _Profile,
    "status": _Body,
    "record": _RecordStart | _RecordStop | _RecordMark,
    "stitch": _Stitch,
    "replay": _Replay,
}
_KEYS: Final[dict[Verb, str]] = {
    "profile": '"profile": NAME, ',
    "record": f'"action": "start", "seconds": NUMBER up to {RECORD_S_MAX}, "name": {RECORD_NAME_RULE} (optional), '
    '"format": "folder" or "mcap" (optional), or "action": "mark", "text": TEXT (optional), or "action": "stop", ',
    "stitch": f'"action": "begin", "name": {RECORD_NAME_RULE} (optional), or "action": "add", "end", "abort" or '
    '"status", ',
    "replay": '"paused": true or false, "step": true, "back": true, "seek_s": NUMBER, "speed": 0.01 to 100 '
    "(each optional), ",
}


@dataclass(frozen=True, slots=True)
class PlaybackCommand:
    """A ``req/replay`` command to a playing recording; None leaves a setting unchanged.

    Attributes
    ----------
    paused : bool or None
    step : bool
        Show the next frame, then pause.
    back : bool
        Show the previous frame, then pause.
    seek_s : float or None
        Jump to this time after the first frame.
    speed : float or None
        Multiple of the recording's pace.
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
        ``replay`` (control a playing recording).
    transaction : str, int or None
        The caller's own mark, echoed in the reply.
    profile : str
        Empty unless the verb is ``profile``.
    action : str
        ``start``, ``mark`` or ``stop`` for the verb ``record``, a `StitchAction` for ``stitch``, else empty.
    name : str
        Name of the recording to start or the session to begin; if empty, the daemon chooses one.
    seconds : float
        Length of the recording.
    text : str
        Text of a mark; may be empty.
    playback : PlaybackCommand or None
        The command of the verb ``replay``.
    format : str
        Format of the recording: a folder of images with their table, or MCAP files.
    response_topic : str or None
        MQTT 5: the topic that the caller wants the reply on, ``res/...`` below the sensor's topics; None is
        ``res/<verb>``.
    correlation : bytes or None
        MQTT 5: correlation data, echoed with the reply.
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
    """Decode the payload of ``req/<verb>``; an empty one means ``{}``.

    Raises
    ------
    DecodeError
        Unknown verb, not JSON, unknown or missing key, wrong type, longer than 4096 bytes.
    """
    known = next((v for v in _BODIES if v == verb), None)
    if known is None:
        found = f"req/{escaped(verb, _ERROR_CHARS_MAX)}: found an unknown verb, expected one of {', '.join(_BODIES)}"
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST)
    if len(payload) > REQUEST_BYTES_MAX:
        found = f"req/{verb}: found {len(payload)} bytes, expected at most {REQUEST_BYTES_MAX}"
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
    """The ``transaction`` of a request that `parse_request` rejected, for the error to echo; None if there is none."""
    try:
        return msgspec.json.decode(payload[:REQUEST_BYTES_MAX], type=_Echo).transaction
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def _expected(verb: Verb) -> str:
    return f'a JSON object {{{_KEYS.get(verb, "")}"transaction": TEXT or INTEGER}}, transaction optional'
