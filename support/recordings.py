"""Recordings of painted sensors that are touched and released, of one and of a hand."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2

from support.painted_sensor import FREE, TOUCHED, painted_calibration
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.errors import DecodeError
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import RecordedFrame, Recording
from tacshade_edge.types import U8, Frame

HEADER = "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"


def write_recording(
    folder: Path, images: Sequence[U8], period_ns: int = 10_000_000, start_ns: int = 500
) -> Path:
    """PNG frames and their table; every other row has a pose."""
    folder.mkdir(parents=True)
    lines = []
    for k, image in enumerate(images):
        cv2.imwrite(str(folder / f"{k:06d}.png"), image)
        pose = f"{k},2.5,-3,1,0,0,0" if k % 2 else ",,,,,,"
        lines.append(f"{k:06d}.png,{start_ns + k * period_ns},{pose}\n")
    (folder / "frames.csv").write_text(HEADER + "".join(lines))
    return folder


LONG_AGO_S = 1_700_000_000


def recorded(folder: Path, name: str, wall_ns: int = LONG_AGO_S * 10**9, **about: object) -> Path:
    """What a recorder leaves."""
    path = folder / name
    path.mkdir(parents=True)
    (path / "000000.png").write_bytes(b"a picture of 600 bytes".ljust(600, b"."))
    (path / "frames.csv").write_text("image,t_ns\n")
    status = {"frames": 1, "bytes": 600, "first_wall_ns": wall_ns, **about}
    (path / "recording.json").write_text(json.dumps(status))
    return path


PLACES_X_MM = {"left-thumb": 50, "left-index": 0}
IMAGES = (FREE, *(TOUCHED,) * 4, *(FREE,) * 4)
PERIOD_NS, T_NS, WALL_NS = 33_333_333, 500, 1_790_000_000_000_000_000


def record_finger(folder: Path, settings: str) -> Path:
    """Make a recording with these settings; return its path."""
    recorder = RecordingWriter(folder)
    recorder.begin(settings, packed(painted_calibration()))
    for seq, image in enumerate(IMAGES):
        t_ns = T_NS + seq * PERIOD_NS
        recorder.add(Frame(seq, t_ns, t_ns + WALL_NS - T_NS, image), png_of(image))
    recorder.finish({"first_t_ns": T_NS, "first_wall_ns": WALL_NS})
    return folder


def record_hand(folder: Path) -> tuple[Path, ...]:
    """Record each finger; return the recordings' paths, which are named by its id."""
    return tuple(
        record_finger(
            folder / name,
            f"{{sensor_id: {name}, hand_id: left, hand_T_sensor: [{x}, 0, 0, 1, 0, 0, 0]}}\n",
        )
        for name, x in PLACES_X_MM.items()
    )


def read_all(recording: Recording) -> tuple[list[RecordedFrame], list[str]]:
    """All frames of a recording, and why others could not be read."""
    frames, refused = list[RecordedFrame](), list[str]()
    while True:
        try:
            if (frame := recording.read()) is None:
                return frames, refused
            frames.append(frame)
        except DecodeError as error:
            refused.append(str(error))
