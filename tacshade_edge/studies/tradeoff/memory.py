"""What memory a setting needs: each in a process of its own, beyond what that had before."""

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
    """Greatest resident memory of each setting while it reconstructs the images, beyond what the process had, in MiB.

    What it had is Python, NumPy, OpenCV, ONNX Runtime and the images; the reconstructor's tables and network, and what
    a step takes for a moment, count.

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
    with contextlib.suppress(OSError):  # a kernel that cannot forget the peak of the imports, which is hardly above
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
