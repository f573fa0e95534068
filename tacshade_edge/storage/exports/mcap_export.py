"""Exports frames, results and a recording's other files as one MCAP file for Foxglove, Lichtblick and Rerun."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from tacshade_edge.protocol.messages import encode_touch
from tacshade_edge.storage.exports.files import NewPlace, contact_numbers
from tacshade_edge.storage.recording.mcap.writer import (
    McapWriter,
    cloud_message,
    height_message,
    log_message,
    transform_message,
)
from tacshade_edge.storage.recording.recorder import png_of
from tacshade_edge.storage.recording.recording import RecordedFrame
from tacshade_edge.storage.recording.recording_content import Event, events_in
from tacshade_edge.types import Calibration, Reconstruction
from tacshade_edge.version import installed_version


class McapExport:
    """One MCAP file; docs/how-to/recordings.md lists its topics.

    The recording's other files (`content`) become attachments, and the events also log lines.
    """

    def __init__(
        self, path: Path, *, sensor_id: str, calibration: Calibration, profile: str, content: Mapping[str, bytes]
    ) -> None:
        self._place = NewPlace(path)
        with self._place.writing():
            self._stream = self._place.partial.open("wb")
            self._writer = McapWriter(self._stream, sensor_id)
            about = {"version": installed_version(), "profile": profile, "calibration_crc32": str(calibration.crc32)}
            self._writer.describe("tacshade", about | {"sensor_id": sensor_id})
            for name, data in content.items():
                self._writer.attach(name, data, 0)
        self._sensor_id, self._flange_T_sensor = sensor_id, calibration.flange_T_sensor
        self._events = list(events_in(dict(content)))
        self._first = True
        self._wall_minus_t_ns = 0

    def add(self, recorded: RecordedFrame, result: Reconstruction) -> None:
        """Write the events before a frame, the frame and its results."""
        frame, wall_ns, ident = recorded.frame, recorded.wall_ns, self._sensor_id
        self._wall_minus_t_ns = wall_ns - frame.t_ns
        with self._place.writing():
            while self._events and self._events[0].t_ns <= frame.t_ns:
                self._log(self._events.pop(0))
            if self._first:
                self._first = False
                mounted = transform_message(self._flange_T_sensor, "flange", "sensor", ident, wall_ns)
                self._writer.write("tf", mounted, wall_ns)
            self._writer.frame(recorded.name, frame, png_of(frame.image), wall_ns)
            self._writer.write("height", height_message(result.height.height_mm, ident, wall_ns), wall_ns, frame.seq)
            self._writer.write("cloud", cloud_message(result.cloud, ident, wall_ns), wall_ns, frame.seq)
            contact = json.dumps(contact_numbers(recorded, result)).encode()
            self._writer.write("contact", contact, wall_ns, frame.seq)
            self._writer.write("touch", encode_touch(replace(result, wall_ns=wall_ns)), wall_ns, frame.seq)

    def finish(self) -> None:
        """Complete the file and move it to its final name."""
        with self._place.writing():
            for event in self._events:
                self._log(event)
            self._writer.finish()
            self._stream.close()
        self._place.take()

    def discard(self) -> None:
        """Remove the unfinished file."""
        self._stream.close()
        self._place.discard()

    def _log(self, event: Event) -> None:
        wall_ns = max(0, event.t_ns + self._wall_minus_t_ns)
        text = f"{event.kind}: {json.dumps(event.data)}" if event.data else event.kind
        self._writer.write("log", log_message("recorder", text, wall_ns), wall_ns)
