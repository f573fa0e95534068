"""Exports of recordings as one MCAP file for viewers, which needs the extra ``mcap``;
docs/how-to/recordings.md.
"""

from __future__ import annotations

import contextlib
import json
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tacshade_edge.recording.exports.table_export import Add, contact_numbers, new_path
from tacshade_edge.recording.mcap.writer import (
    McapWriter,
    cloud_message,
    height_message,
    log_message,
    transform_message,
)
from tacshade_edge.recording.recorder import png_of
from tacshade_edge.recording.recording import RecordedFrame
from tacshade_edge.recording.recording_content import events_in
from tacshade_edge.types import Calibration, Reconstruction
from tacshade_edge.version import installed_version
from tacshade_edge.wire.hand_messages import encode_hand
from tacshade_edge.wire.hand_topics import HandObjects
from tacshade_edge.wire.messages import encode_touch


@contextlib.contextmanager
def mcap_export(
    path: Path,
    *,
    sensor_id: str,
    calibration: Calibration,
    profile: str,
    content: Mapping[str, bytes],
) -> Iterator[Add]:
    """Frames and results; the recording's other files (`content`) become attachments,
    and the events also log lines.
    """
    events = deque(events_in(dict(content)))
    wall_minus_t_ns: int | None = None
    with new_path(path) as partial, partial.open("wb") as stream:
        writer = McapWriter(stream, sensor_id)
        numbers = {"profile": profile, "calibration_crc32": str(calibration.crc32)}
        writer.describe(
            "tacshade", {"version": installed_version(), **numbers, "sensor_id": sensor_id}
        )
        # Before the frames: of a file that is cut off they can still be read.
        for name, data in content.items():
            writer.attach(name, data, 0)

        # Between the frames, because many readers take the file's order for that of time.
        def log(until_ns: float) -> None:
            while events and events[0].t_ns <= until_ns:
                event = events.popleft()
                wall_ns = max(0, event.t_ns + (wall_minus_t_ns or 0))
                text = f"{event.kind}: {json.dumps(event.data)}" if event.data else event.kind
                writer.write("log", log_message("recorder", text, wall_ns), wall_ns)

        def add(recorded: RecordedFrame, result: Reconstruction) -> None:
            nonlocal wall_minus_t_ns
            frame, wall_ns = recorded.frame, recorded.wall_ns
            is_first, wall_minus_t_ns = wall_minus_t_ns is None, wall_ns - frame.t_ns
            log(frame.t_ns)
            # Once: the sensor stays where it is mounted.
            if is_first:
                mounted = transform_message(
                    calibration.flange_T_sensor, "flange", "sensor", sensor_id, wall_ns
                )
                writer.write("tf", mounted, wall_ns)
            writer.frame(recorded.name, frame, png_of(frame.image), wall_ns)
            for name, payload in _results(recorded, result, sensor_id).items():
                writer.write(name, payload, wall_ns, frame.seq)

        yield add
        log(float("inf"))
        writer.finish()


def _results(recorded: RecordedFrame, result: Reconstruction, sensor_id: str) -> dict[str, bytes]:
    wall_ns, height_mm = recorded.wall_ns, result.height.height_mm
    # An image has no flag that says that the 0 of an unusable frame is none.
    known_mm = height_mm if result.valid else np.full_like(height_mm, np.nan)
    return {
        "height": height_message(known_mm, sensor_id, wall_ns),
        "cloud": cloud_message(result.cloud, sensor_id, wall_ns),
        "contact": json.dumps(contact_numbers(recorded, result)).encode(),
        # The result of a recorded frame has no Unix time.
        "touch": encode_touch(replace(result, wall_ns=wall_ns)),
    }


def write_hand_mcap(path: Path, hand_id: str, messages: Iterable[HandObjects]) -> int:
    """Write the topic ``/tacshade/hand/ID/objects``; return the number of messages.

    Raises like `new_path`.
    """
    count = 0
    with new_path(path) as partial, partial.open("wb") as stream:
        writer = McapWriter(stream, f"hand/{hand_id}")
        writer.describe("tacshade", {"version": installed_version(), "hand_id": hand_id})
        for count, message in enumerate(messages, 1):  # noqa: B007
            writer.write("objects", encode_hand(message), message.wall_ns, message.seq)
        writer.finish()
    return count
