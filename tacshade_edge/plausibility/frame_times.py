"""Times of frames against the rates of cameras."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import median
from typing import Final

from tacshade_edge.plausibility.suspicions import Suspicion, SuspicionCode, suspicion
from tacshade_edge.plausibility.units import TIMES, nearest
from tacshade_edge.quoting import quoted

STEP_LEAST_NS: Final = 100_000
"""No camera takes ten thousand frames a second of a skin."""
STEPS_JUDGED: Final = 1000
"""The first steps of a table show its unit."""
_USUAL_STEP_NS: Final = 33e6


def judge_steps(steps_ns: Sequence[int]) -> Suspicion | None:
    """What is wrong with the times from each frame to the next; None if they are a camera's.

    Slow frames are no mistake: one a day is a record of wear.
    """
    if not steps_ns or (step_ns := median(steps_ns)) >= STEP_LEAST_NS:
        return None
    # A clock of whole seconds gives steps of 0 and 1.
    unit = nearest(_USUAL_STEP_NS / max(step_ns, 1.0), TIMES)
    return suspicion(
        SuspicionCode.STEPS_TOO_SHORT,
        step_ns=step_ns,
        least_ns=STEP_LEAST_NS,
        unit=unit,
    )


def judge_time_cell(cell: str) -> Suspicion | None:
    """What a cell that is no whole number of nanoseconds seems to be: a time in seconds, or one
    that a spreadsheet has rounded; None if it is neither.
    """
    text = cell.strip().replace(",", ".")
    try:
        value = float(text)
    except ValueError:
        return None
    if text.isdecimal() or not 0 <= value < math.inf:
        return None
    rounded = "e" in text.lower()
    return suspicion(
        SuspicionCode.TIME_ROUNDED if rounded else SuspicionCode.TIME_FRACTION,
        impossible=True,
        found=quoted(cell, 40),
    )
