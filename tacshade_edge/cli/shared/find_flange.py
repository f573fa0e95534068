"""``tacshade-edge stitch --find-flange``: finds the sensor's pose on the flange and the delay of its frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from tacshade_edge.core.stitching.flange import FoundFlange, find_flange
from tacshade_edge.core.stitching.flange_equations import ContactFrame
from tacshade_edge.core.stitching.flange_motions import delay_seen, unseen
from tacshade_edge.core.stitching.refinement import correction
from tacshade_edge.errors import ConfigError
from tacshade_edge.rigid import Rigid
from tacshade_edge.storage.stitching.map_files import FLANGE, write_flange

PRESSES_MIN = 12
START_MM, START_DEG = 15.0, 15.0
"""Largest plausible distance and rotation from the start; a pose found farther away is wrong."""
_PLAN = "(see the plan in docs/how-to/stitching.md)"


def run(
    frames: Sequence[ContactFrame], start: Rigid, skin_radius_mm: float, out: Path, where: str, *, as_json: bool
) -> None:
    """Find flange_T_sensor and the delay, write them to `out` and print them.

    Raises
    ------
    ConfigError
        There are too few presses, a motion is missing, or the presses agree at no pose near the start.
    """
    presses = len({frame.press for frame in frames})
    if presses < PRESSES_MIN:
        raise ConfigError(
            f"{where}: found {presses} presses with a pose, expected at least {PRESSES_MIN} presses {_PLAN}"
        )
    try:
        found = find_flange(frames, start, skin_radius_mm)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
    if why := unseen(frames, start, found):
        raise ConfigError(f"{where}: {why} {_PLAN}")
    moved_mm, turned_deg = correction(start, found.flange_T_sensor, np.zeros(3))
    if moved_mm > START_MM or turned_deg > START_DEG:
        raise ConfigError(
            f"{where}: found flange_T_sensor {moved_mm:.0f} mm and {turned_deg:.0f} degrees from the calibration's, "
            f"expected at most {START_MM:g} mm and {START_DEG:g} degrees; is base_T_flange in mm?"
        )
    seen = delay_seen(found)
    write_flange(out, found, delay_seen=seen, presses=presses, frames=len(frames))
    if as_json:
        print((out / FLANGE).read_text(encoding="utf-8"), end="")
    else:
        _print(out, found, presses, moved_mm, turned_deg, seen)


def _print(out: Path, found: FoundFlange, presses: int, moved_mm: float, turned_deg: float, seen: bool) -> None:
    sigma = np.sqrt(np.diag(found.covariance))
    values = ", ".join(f"{value:.6g}" for value in found.flange_T_sensor.seven())
    print(f"{out / FLANGE}: {presses} presses; {moved_mm:.2f} mm and {turned_deg:.2f} degrees from the calibration's")
    print(
        f"in SENSOR.yaml, then calibrate again: flange_T_sensor: [{values}]  "
        f"# within {max(sigma[:3]):.2f} mm, {max(sigma[3:6]):.2f} degrees (standard deviation)"
    )
    if seen:
        print(f"delay: frames are stamped {found.delay_ms:.1f} ms (± {sigma[6]:.1f}) later than the robot's poses")
    else:
        print(
            "delay: not found: no press moves while in contact, expected a recording of presses down and up at 10 mm/s"
        )
