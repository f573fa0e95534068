"""Measure the memory that a setting adds to a process, each setting in its own process."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Sequence
from pathlib import Path

from tacshade_edge.studies.parallel import Report, processes, reported_map
from tacshade_edge.studies.tradeoff.grid import Setting, make
from tacshade_edge.types import U8, Calibration, Frame


def peak_memory(
    settings: Sequence[Setting], calibration: Calibration, images: Sequence[U8], report: Report
) -> list[float]:
    """Peak resident memory in MiB that each setting adds to its process while it reconstructs the images.

    Python, NumPy, OpenCV, ONNX Runtime and the images do not count; the reconstructor's tables and network, and the
    temporary memory of a step, do.

    Raises
    ------
    DeviceError
        A worker process was killed.
    """
    tasks = [(setting, calibration, images) for setting in settings]
    with processes(fresh=True) as workers:
        return list(reported_map(_peak_mib, tasks, workers, report, "settings weighed"))


def _peak_mib(task: tuple[Setting, Calibration, Sequence[U8]]) -> float:
    setting, calibration, images = task
    with contextlib.suppress(OSError):  # if a kernel cannot reset the peak, that of the imports is hardly higher
        Path("/proc/self/clear_refs").write_text("5")
    before = _greatest_kib()
    made = make(setting, calibration)
    for image in images:
        made.step(Frame(0, 0, 0, image))
    return (_greatest_kib() - before) / 1024


def _greatest_kib() -> int:
    found = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1])
