"""Turn the rows into tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from tacshade_edge.studies.tables import markdown
from tools.studies.object_motion.score import MotionRow

WITHIN_MM, WITHIN_DEG, JUMP_MM = 0.4, 3.0, 0.5
HEADER: Final = (
    *("what", "fingers", "trials", "within 0.4 mm and 3° %", "off mm: median", "95 %", "off °: median", "95 %"),
    *("in the 90 % ellipsoid %", "unobservable", "named %", "jump mm: greatest", "ms a step"),
)


def text(rows: Sequence[MotionRow]) -> str:
    """Write a table per event, with rows by number of fingers: for all trials, then for each object and skin."""
    parts = []
    for event in dict.fromkeys(row.event for row in rows):
        some = [row for row in rows if row.event == event]
        lines = []
        for count in sorted({row.fingers for row in some}):
            counted = [row for row in some if row.fingers == count]
            lines.append(_line("all", counted))
            names = dict.fromkeys(name for row in counted for name in (row.object, row.skin))
            lines += [_line(name, [row for row in counted if name in (row.object, row.skin)]) for name in names]
        parts.append(f"{event.capitalize()}\n\n{markdown(HEADER, lines)}")
    return "\n\n".join(parts)


def _line(what: str, rows: Sequence[MotionRow]) -> tuple[str, ...]:
    seen = [row for row in rows if not row.hidden]
    within = [row.translation_off_mm <= WITHIN_MM and row.rotation_off_deg <= WITHIN_DEG for row in seen]
    off_mm = [row.translation_off_mm for row in seen]
    off_deg = [row.rotation_off_deg for row in seen]
    return (
        *(what, str(rows[0].fingers), str(len(rows)), f"{100 * np.mean(within):.0f}" if seen else ""),
        *((f"{np.median(off_mm):.2f}", f"{np.quantile(off_mm, 0.95):.2f}") if seen else ("", "")),
        *((f"{np.median(off_deg):.1f}", f"{np.quantile(off_deg, 0.95):.1f}") if seen else ("", "")),
        f"{100 * np.mean([row.ellipsoid <= 1 for row in rows]):.0f}",
        ", ".join(map(str, sorted({row.hidden for row in rows}))),
        f"{100 * np.mean([row.named for row in rows]):.0f}",
        f"{max(row.jump_mm for row in rows):.2f}",
        f"{np.mean([row.step_ms for row in rows]):.2f}",
    )
