"""The registry of faults, and the table of their outcomes."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from tools.faults import (
    bridge_faults,
    broker_faults,
    capture_faults,
    disk_faults,
    page_faults,
    process_faults,
    request_faults,
    robot_faults,
    source_faults,
)
from tools.faults.rig import Cell, Seen, SkippedError

Fault = Callable[[Cell], Seen]
FAULTS: dict[str, Fault] = {
    **broker_faults.FAULTS,
    **bridge_faults.FAULTS,
    **request_faults.FAULTS,
    **robot_faults.FAULTS,
    **source_faults.FAULTS,
    **disk_faults.FAULTS,
    **process_faults.FAULTS,
    **page_faults.FAULTS,
    **capture_faults.FAULTS,
}
HEAD = ("fault", "detected s", "recovered s", "lost", "told where")


def run_one(fault: Fault) -> Seen:
    """Run a fault with a new daemon and broker. Raises AssertionError (a promise is broken) and SkippedError."""
    with TemporaryDirectory() as name, Cell(Path(name) / "cell") as cell:
        return fault(cell)


def run(names: list[str] | None, tell: Callable[[str], None]) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the rows of the table, each with its problem or an empty string."""
    for name, fault in FAULTS.items():
        if names and not any(word in name for word in names):
            continue
        began_s = time.monotonic()
        problem = ""
        try:
            seen = run_one(fault)
            row = (name, _seconds(seen.detected_s), _seconds(seen.recovered_s), seen.lost, seen.told)
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


def _seconds(value: float | None) -> str:
    return "" if value is None else f"{value:.1f}"
