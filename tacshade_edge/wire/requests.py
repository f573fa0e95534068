"""Decode the JSON payloads of ``req/<verb>`` strictly, and encode those of ``res/<verb>``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec.structs import asdict

from tacshade_edge.errors import DecodeError
from tacshade_edge.quoting import escaped
from tacshade_edge.reasons import Reason, ReasonCode, reason_fields
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.error_words import error_word
from tacshade_edge.wire.results import ReferenceTaken, RequestResult

Verb = Literal["reference", "profile", "status", "record", "stitch", "replay"]
StitchAction = Literal["begin", "add", "end", "abort", "status"]
Transaction = (
    Annotated[str, msgspec.Meta(max_length=128)]
    # Within what a JavaScript number holds exactly, so that the echo is the same number.
    | Annotated[int, msgspec.Meta(ge=-(2**53), le=2**53)]
    | None
)
# Anyone who reaches the broker may send one, and parsing happens in paho's thread.
REQUEST_BYTES_MAX: Final = 4096
# 40 GB of grey 640x480 at 60 per second.
RECORD_S_MAX: Final = 3600
# \Z and not $, which also matches before a final newline.
RECORD_NAME: Final = r"\A[A-Za-z0-9_-][A-Za-z0-9._-]{0,63}\Z"
"""Also for a stitching session: recordings and sessions name their folders."""
RECORD_NAME_RULE: Final = "up to 64 letters, digits, '.', '_' and '-', not starting with '.'"
_ERROR_CHARS_MAX: Final = 200


# Unknown keys are errors: a misspelt key must not do something else silently.
class _Body(msgspec.Struct, forbid_unknown_fields=True, kw_only=True, frozen=True):
    transaction: Transaction = None


class _Profile(_Body, frozen=True):
    profile: Annotated[str, msgspec.Meta(min_length=1, max_length=128)]


class _RecordStart(_Body, frozen=True, tag_field="action", tag="start"):
    seconds: Annotated[float, msgspec.Meta(gt=0, le=RECORD_S_MAX)]
    name: Annotated[str, msgspec.Meta(pattern=RECORD_NAME)] | None = None


class _RecordStop(_Body, frozen=True, tag_field="action", tag="stop"):
    pass


class _RecordMark(_Body, frozen=True, tag_field="action", tag="mark"):
    text: Annotated[str, msgspec.Meta(max_length=200)] = ""


class _Stitch(_Body, frozen=True):
    action: StitchAction
    name: Annotated[str, msgspec.Meta(pattern=RECORD_NAME)] | None = None

    def __post_init__(self) -> None:
        # The other actions are of the open session, which has a name already.
        if self.name is not None and self.action != "begin":
            raise ValueError(f"found a name with the action {self.action}")


class PlaybackCommand(_Body, frozen=True):
    """A ``req/replay`` command to a playing recording; None leaves a setting unchanged.

    `step` and `back` show the next or previous frame and then pause; `seek_s` jumps to this time
    after the first frame; `speed` is a multiple of the recording's pace.
    """

    paused: bool | None = None
    step: bool = False
    back: bool = False
    seek_s: Annotated[float, msgspec.Meta(ge=0, le=1e9)] | None = None
    speed: Annotated[float, msgspec.Meta(ge=0.01, le=100)] | None = None


# Lenient, unlike `_Body`: whatever else is wrong, the error should reach its asker.
class _Echo(msgspec.Struct):
    transaction: Transaction = None


_BODIES: Final[dict[Verb, Any]] = {
    "reference": _Body,
    "profile": _Profile,
    "status": _Body,
    "record": _RecordStart | _RecordStop | _RecordMark,
    "stitch": _Stitch,
    "replay": PlaybackCommand,
}


@dataclass(frozen=True, slots=True)
class Request:
    """One command from ``req/<verb>``; fields that its verb does not have are empty.

    The reply echoes `transaction` and MQTT 5's `correlation`; `response_topic`, ``res/...`` below
    the sensor's topics, replaces ``res/<verb>``. Without a `name`, the daemon names the recording
    or session itself.
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


def parse_request(
    verb: str,
    payload: bytes,
    *,
    response_topic: str | None = None,
    correlation: bytes | None = None,
) -> Request:
    """Decode the payload of ``req/<verb>``; an empty one means ``{}``.

    Raises DecodeError for an unknown verb, no JSON, an unknown or missing key,
    a wrong type or more than 4096 bytes.
    """
    known = next((v for v in _BODIES if v == verb), None)
    if known is None:
        found = (
            f"req/{escaped(verb, _ERROR_CHARS_MAX)}: found an unknown verb, expected one of "
            f"{', '.join(_BODIES)}"
        )
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST)
    if len(payload) > REQUEST_BYTES_MAX:
        found = f"req/{verb}: found {len(payload)} bytes, expected at most {REQUEST_BYTES_MAX}"
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST)
    try:
        body = msgspec.json.decode(payload or b"{}", type=_BODIES[known])
    # Brackets alone nest deep enough for a RecursionError.
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        found = (
            f"req/{verb}: {escaped(str(error), _ERROR_CHARS_MAX)}; expected the keys in "
            "docs/reference/mqtt.md"
        )
        raise DecodeError(found, code=ReasonCode.BAD_REQUEST) from error
    fields = {name: value for name, value in asdict(body).items() if value is not None}
    if tag := body.__struct_config__.tag:
        fields["action"] = tag
    # Whole: here None leaves a setting as it is, so it must not be dropped with the others.
    if isinstance(body, PlaybackCommand):
        fields = {"transaction": body.transaction, "playback": body}
    return Request(known, response_topic=response_topic, correlation=correlation, **fields)


def parse_transaction(payload: bytes) -> str | int | None:
    """The ``transaction`` of a request that `parse_request` rejected, for the error to echo;
    None if there is none.
    """
    try:
        # Cut, since a request that is too long is rejected too; what is cut is no JSON, and has
        # none.
        return msgspec.json.decode(payload[:REQUEST_BYTES_MAX], type=_Echo).transaction
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def encode_reply(request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> bytes:
    """The reply to a request: ``{"transaction", "ok": true, "result":
    {...}}``, or that of `encode_error`.

    The error of ``stitch`` begins with the serial line's word for its code.
    """
    if isinstance(outcome, Reason):
        # Scripts for the robot's line and for MQTT can look for the same words.
        word = f"{error_word(outcome.code)}: " if request.verb == "stitch" else ""
        return encode_error(request.transaction, Reason(outcome.code, f"{word}{outcome.text}"))
    result = outcome if isinstance(outcome, Mapping) else outcome.figures()
    if isinstance(outcome, ReferenceTaken):
        result = {**result, **reason_fields(outcome.unstored)}
    return encode_json({"transaction": request.transaction, "ok": True, "result": result})


def encode_error(transaction: str | int | None, reason: Reason) -> bytes:
    """The reply to a request that failed: ``{"transaction", "ok": false, "error":
    "one line", "reason_code"}``.
    """
    return encode_json(
        {"transaction": transaction, "ok": False, "error": reason.text, "reason_code": reason.code}
    )
