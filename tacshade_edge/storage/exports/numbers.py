"""The numbers of a result: the keys of ``contact`` and a few more, flat."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Final

from tacshade_edge.protocol.messages import encode_contact, touch_fields
from tacshade_edge.reasons import code_of
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction

POSE_COLUMNS: Final = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


def contact_numbers(recorded: RecordedFrame, result: Reconstruction) -> dict[str, Any]:
    """The fields of ``contact`` (docs/reference/mqtt/frames.md) without ``fps``, which only a daemon knows."""
    numbers: dict[str, Any] = json.loads(encode_contact(result, fps=0.0))
    del numbers["fps"]
    numbers["wall_ns"] = recorded.wall_ns  # a recording's results have none, so that equal recordings give equal bytes
    return numbers


def touch_numbers(result: Reconstruction, names: Sequence[str]) -> tuple[list[float | None], list[float | None]]:
    """The named quantities of the touch, and their standard deviations; None if unknown."""
    fields = touch_fields(result.touch)
    values, sigmas = ([(fields[key] or {}).get(name) for name in names] for key in ("touch", "touch_sigma"))
    return values, sigmas


def frame_numbers(recorded: RecordedFrame, result: Reconstruction, touch_names: Sequence[str]) -> dict[str, Any]:
    """A table row: image, times, the numbers of contact and touch, ``base_T_flange``; None for a missing value."""
    values, sigmas = touch_numbers(result, touch_names)
    frame = recorded.frame
    pose = frame.pose
    return {
        "image": recorded.name,
        "valid": int(result.valid),
        "saturated": int(result.saturated),
        **contact_numbers(recorded, result),
        **{f"touch_{name}": value for name, value in zip(touch_names, values, strict=True)},
        **{f"touch_sigma_{name}": value for name, value in zip(touch_names, sigmas, strict=True)},
        "touch_reason_code": code_of(None if result.touch is None else result.touch.reason),
        **{f"flange_{name}": None if pose is None else float(getattr(pose, name)) for name in POSE_COLUMNS},
        "pose_error_us": None if pose is None else frame.pose_error_us,
    }
