"""The table of the faults' outcomes."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.faults import broker_faults, disk_faults, input_faults, process_faults
from tools.faults.rig import FAULTS, Cell, Fault, SkippedError

MODULES = (broker_faults, input_faults, disk_faults, process_faults)
"""Whose functions are in `FAULTS`, in this order."""
HEAD = ("fault", "detected s", "recovered s", "lost", "told where")


def run_one(fault: Fault) -> tuple[str, ...]:
    """Run a fault with a new daemon and broker; return its cells. Raises AssertionError if a promise is broken."""
    with TemporaryDirectory() as name, Cell(Path(name) / "cell") as cell:
        seen = fault(cell)
    times = ("" if value is None else f"{value:.1f}" for value in (seen.detected_s, seen.recovered_s))
    return (*times, seen.lost, seen.told)


def run(words: list[str] | None, tell: Callable[[str], None]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the rows of the table, each with its problem or an empty string."""
    for name, fault in FAULTS.items():
        if words and not any(word in name for word in words):
            continue
        began_s, problem = time.monotonic(), ""
        try:
            row = (name, *run_one(fault))
        except SkippedError as skipped:
            row = (name, "", "", f"not tried: {skipped}", "")
        except Exception as error:  # noqa: BLE001
            row = (name, "", "", "**not as promised**", "")
            problem = f"{name}: {error or type(error).__name__}\n{traceback.format_exc(limit=-2)}"
        tell(f"{time.monotonic() - began_s:5.1f} s {' | '.join(row)}")
        yield row, problem


def table(rows: list[tuple[str, ...]]) -> str:
    """Write the table."""
    lines = ["| " + " | ".join(HEAD) + " |", "|---|---:|---:|---|---|"]
    return "\n".join((*lines, *("| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows)))
