"""What the tests in the guests are handed, which only arithmetic can give: `make_handed_in` makes it.

This module is imported where everything is emulated and an import of the program costs ten seconds.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

GIVEN = Path(__file__).resolve().parents[2] / ".rig/given"
PAINTED, PRESSED = GIVEN / "painted", GIVEN / "pressed"
"""Each with calibration.npz and images.npy (N, 480, 640); of the pressed ones facts.json, of what `PROFILE` finds."""
PROFILE = "fast"
CAPTURED = GIVEN / "captured.npy"
"""(1, 480, 640): the simulated sensor free, for a person to take references."""
IMAGES_A_PRESS = 10


def pressed_facts() -> dict[str, Any]:
    """Of each press x_mm, depth_mm (the truth) and found_mm (by the core, of the same image)."""
    known: dict[str, Any] = json.loads((PRESSED / "facts.json").read_text())
    return known
