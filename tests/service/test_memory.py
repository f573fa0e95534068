"""What the daemon takes of a small board's memory, as tools/benchmarks/memory.py measures it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tools.testbed.mqtt_rig import MOSQUITTO

FRAMES, FPS = 1_500, 150  # as fast as a busy machine of two cores reads them; what comes too fast is superseded
# Measured with ONNX Runtime 1.32, which takes 8 MB more than 1.28: 120.6 MB after a tenth, 120.8 at the end and at the
# peak of 5000 frames. A kilobyte forgotten with each frame of these: 1.3 MB.
RESIDENT_MAX_MB, GROWTH_MAX_MB = 128.0, 1.2


@pytest.mark.slow
@pytest.mark.broker
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_it_stays_small_and_does_not_grow(tmp_path: Path) -> None:
    figures = tmp_path / "memory.json"
    words = f"-m tools.benchmarks.memory --frames {FRAMES} --fps {FPS} --json {figures}"
    command = [sys.executable, *words.split()]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    read = json.loads(figures.read_text())
    assert read["frames"]["published"] >= FRAMES / 2
    begin, _, whole = read["after"].values()
    assert 0 < whole["peak"] < RESIDENT_MAX_MB
    assert whole["resident"] - begin["resident"] < GROWTH_MAX_MB
    print(done.stdout)
