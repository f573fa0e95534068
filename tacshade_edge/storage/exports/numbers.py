"""What of a result is a number: the keys of ``contact`` and a few more, flat."""

from __future__ import annotations

import json
from typing import Any, Final

from tacshade_edge.protocol.messages import encode_contact
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.types import Reconstruction

POSE_COLUMNS: Final = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")


def contact_numbers(recorded: RecordedFrame, result: Reconstruction) -> dict[str, Any]:
    """As ``contact`` of docs/mqtt.md, without ``fps``, which only a daemon has."""
    numbers: dict[str, Any] = json.loads(encode_contact(result, fps=0.0))
    del numbers["fps"]
    numbers["wall_ns"] = recorded.wall_ns  # results of a recording have none, so that equal ones give equal bytes
    return numbers


def frame_numbers(recorded: RecordedFrame, result: Reconstruction) -> dict[str, Any]:
    """A row of a table: image and times, the numbers of the contact, ``base_T_flange``; None where there is none."""
    frame = recorded.frame
    pose = frame.pose
    return {
        "image": recorded.name,
        "valid": int(result.valid),
        "saturated": int(result.saturated),
        **contact_numbers(recorded, result),
        **{f"flange_{name}": None if pose is None else float(getattr(pose, name)) for name in POSE_COLUMNS},
        "pose_error_us": None if pose is None else frame.pose_error_us,
    }
