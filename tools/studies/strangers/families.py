"""The families by name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tools.studies.strangers.layered import layered
from tools.studies.strangers.oblate import oblate
from tools.studies.strangers.sensor import Stranger
from tools.studies.strangers.third import Third

FAMILIES: dict[str, Callable[[str, int, Path], Stranger]] = {
    "third": Third,
    "layered": layered,
    "oblate": oblate,
}
"""Makes a sensor of a range (``working`` or ``final``) with a number,
from a folder of solved states.
"""
