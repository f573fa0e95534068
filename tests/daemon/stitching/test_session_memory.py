"""What a session takes that is as full as one can be, spread as far as it may, and what is left of it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

MOST_MB = 300
"""Beside what the daemon takes without a session; `systemd/serial.conf` gives both."""
LEFT_MB = 40
"""When it has ended; without a word to the C library it was 200."""
SCENARIO = """
import sys, tempfile
from pathlib import Path
import numpy as np
from tools.testbed.painted_sensor import painted_calibration
from tacshade_edge.core.stitching.press_points import PressPoints
from tacshade_edge.core.stitching.surface_map import EXTENT_MAX_TILES, TILES_MAX
from tacshade_edge.daemon.session import Session
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.rigid import Rigid


def memory_mb(field):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field)) / 1024


x, y = np.meshgrid(np.arange(62) * 0.25, np.arange(62) * 0.25)  # fills a tile
points = np.stack((x, y, 20 + 0.3 * np.sin(x / 3)), axis=-1).reshape(-1, 3).astype(np.float32)
press = PressPoints(points, np.tile(np.float32((0, 0, 1)), (len(points), 1)), np.ones(len(points), np.float32))
side = int(TILES_MAX**0.5)
apart_mm = 16.0 * (EXTENT_MAX_TILES / TILES_MAX) ** 0.5
with tempfile.TemporaryDirectory() as folder:
    session = Session.begin(Path(folder), "full", painted_calibration(), "left")
    before = memory_mb("VmRSS")
    for k in range(TILES_MAX):
        at = np.array((k % side * apart_mm + 0.1, k // side * apart_mm + 0.1, 0.0))
        session.add(press, Rigid(np.eye(3), at), k)
    assert session.status(0).tiles == TILES_MAX
    session.map_revision().raster()
    session.finish(0)
del session
return_free_memory()
print(memory_mb("VmHWM") - before, memory_mb("VmRSS") - before)
"""


@pytest.mark.slow
def test_a_full_session_stays_within_what_the_service_has() -> None:
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(("tests", os.environ.get("PYTHONPATH", "")))}
    words = [sys.executable, "-c", SCENARIO]
    root = Path(__file__).parents[3]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=root, env=environment)
    assert done.returncode == 0, done.stderr
    most_mb, left_mb = map(float, done.stdout.split())
    assert 100 < most_mb < MOST_MB
    assert left_mb < LEFT_MB
