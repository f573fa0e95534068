#!/usr/bin/env python3
"""Run the tests of tests/guest in a guest with a real kernel, systemd and udev (tools/rig).

::

    python3 -m tools.ci.run_guest [TEST...]

Exits as pytest does, or with 77 or 125 as tools/rig/guest.py does. The results are in
``.rig/out/results.xml``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np

from support.painted_sensor import FREE, TOUCHED, enlarged, enlarged_calibration
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Frame

TREE = Path(__file__).resolve().parents[2]
GIVEN, OUT = TREE / ".rig/given", TREE / ".rig/out"
PROFILE = "fast"
SILENT_S = 240
"""A guest that works gives a sign each second; a slow machine boots it for minutes."""
# Without plugins that take half a minute to import there.
PYTEST = (
    "pytest",
    "-p",
    "no:cacheprovider",
    "-p",
    "no:faulthandler",
    "-p",
    "no:hypothesispytest",
    "--timeout=1800",
    "--tb=native",
)


def give() -> None:
    """Write what a guest has no time to compute: a camera's images, its calibration,
    the depth that the core finds.
    """
    GIVEN.mkdir(parents=True, exist_ok=True)
    calibration = enlarged_calibration()
    calibration_file.save(GIVEN / "calibration.npz", calibration)
    np.save(GIVEN / "images.npy", np.stack([enlarged(FREE), enlarged(TOUCHED), enlarged(TOUCHED)]))
    found = make_reconstructor(calibration, PROFILES[PROFILE]).step(
        Frame(0, 0, 0, enlarged(TOUCHED))
    )
    (GIVEN / "depth_mm").write_text(f"{np.nanmax(found.height.height_mm)}")


def main() -> int:
    """Give the guest what it needs, and run the tests."""
    give()
    shutil.rmtree(OUT, ignore_errors=True)
    chosen = sys.argv[1:] or ["tests/guest"]
    inside = [
        sys.executable,
        "-m",
        *PYTEST,
        "--confcutdir=tests/guest",
        "--junitxml=/out/results.xml",
        *chosen,
    ]
    guest = [
        sys.executable,
        "-m",
        "tools.rig.guest",
        "--silent",
        f"{SILENT_S}",
        "--out",
        str(OUT),
        *inside,
    ]
    return subprocess.run(guest, cwd=TREE, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
