"""What a hand's supervisor loads before it forks."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tools.testbed.patience import patience

SCRIPT = """
import os, sys
from pathlib import Path
import numpy as np
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference import network
from tacshade_edge.types import Frame
from support.calibrated_sensor import calibrated, pressed

def threads():
    return len(list(Path("/proc/self/task").iterdir()))

calibration, image, profile = calibrated(), pressed("ball", 2.0).image, PROFILES["balanced"]

def result():
    made = network.make_reconstructor(calibration, profile).step(Frame(0, 0, 0, image))
    return made.height.height_mm.tobytes() + made.shear_mm.tobytes()

by_itself, before = result(), threads()
network.preload(profile)
assert threads() == before, "what is forked has one thread"
loads = []
real = network.load_network
network.load_network = lambda *args: loads.append(args) or real(*args)
child = os.fork()
if not child:
    os._exit(0 if result() == by_itself and not loads else 1)
assert os.waitpid(child, 0)[1] == 0
assert result() == by_itself and not loads
network.make_reconstructor(calibration, PROFILES["fast"])
assert len(loads) == 1, "another profile's is loaded"
"""


@pytest.mark.slow
def test_a_preloaded_network_works_in_a_forked_process() -> None:
    here = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = (sys.executable, "-c", SCRIPT)
    done = subprocess.run(words, env=here, capture_output=True, text=True, check=False, timeout=patience(120))
    assert done.returncode == 0, done.stderr
