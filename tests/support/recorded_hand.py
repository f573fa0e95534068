"""Recordings of a hand with two painted sensors that are touched and released."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.types import Frame
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

PLACES_X_MM = {"left-thumb": 50, "left-index": 0}
IMAGES = (FREE, *(TOUCHED,) * 4, *(FREE,) * 4)
PERIOD_NS, T_NS, WALL_NS = 33_333_333, 500, 1_790_000_000_000_000_000


def record_finger(folder: Path, settings: str) -> Path:
    """Make a recording with these settings; return its path."""
    recorder = Recorder(folder)
    recorder.begin(settings, painted_calibration())
    for seq, image in enumerate(IMAGES):
        t_ns = T_NS + seq * PERIOD_NS
        recorder.add(Frame(seq, t_ns, t_ns + WALL_NS - T_NS, image), png_of(image))
    recorder.finish({"first_t_ns": T_NS, "first_wall_ns": WALL_NS})
    return folder


def record_hand(folder: Path) -> tuple[Path, ...]:
    """Record each finger; return the recordings' paths, which are named by its id."""
    return tuple(
        record_finger(folder / name, f"{{sensor_id: {name}, hand_id: left, hand_T_sensor: [{x}, 0, 0, 1, 0, 0, 0]}}\n")
        for name, x in PLACES_X_MM.items()
    )
