"""Encode the JSON payloads of ``res/<verb>``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from tacshade_edge.protocol.json_payload import encode_json
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.results import NoSession, ReferenceTaken, RequestResult, SessionEnded, SessionStatus
from tacshade_edge.protocol.serial.answers import error_word
from tacshade_edge.reasons import Reason, reason_fields


def encode_result(transaction: str | int | None, result: RequestResult | Mapping[str, Any]) -> bytes:
    """The reply to a request that succeeded: ``{"transaction", "ok": true, "result": {...}}``."""
    return encode_json({"transaction": transaction, "ok": True, "result": _result_json(result)})


def encode_error(transaction: str | int | None, reason: Reason) -> bytes:
    """The reply to a request that was rejected or failed.

    ``{"transaction", "ok": false, "error": "one line", "reason_code"}``.
    """
    return encode_json({"transaction": transaction, "ok": False, "error": reason.text, "reason_code": reason.code})


def encode_reply(request: Request, outcome: RequestResult | Mapping[str, Any] | Reason) -> bytes:
    """The reply to a request; the error of ``stitch`` begins with the serial line's word for its code."""
    if not isinstance(outcome, Reason):
        return encode_result(request.transaction, outcome)
    if request.verb != "stitch":
        return encode_error(request.transaction, outcome)
    error = f"{error_word(outcome.code)}: {outcome.text}"
    return encode_json({"transaction": request.transaction, "ok": False, "error": error, "reason_code": outcome.code})


def _result_json(result: RequestResult | Mapping[str, Any]) -> object:
    """A result with numbers rounded as on the serial line."""
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
