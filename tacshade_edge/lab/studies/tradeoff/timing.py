"""What outputs cost on this machine: processor time of each part of a frame, and memory."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Sequence
from pathlib import Path

from tacshade_edge.lab.parallel import Report, processes, reported_map
from tacshade_edge.lab.studies.tradeoff.judging import OUTPUTS, JudgedFrames, Setting
from tacshade_edge.sensor.inference.network import runtime
from tacshade_edge.types import U8, Calibration, Frame, Need

SLICE_MS = 100.0
"""Time for each setting in a round; at least one frame, at most all of them."""
IDLE_FRAMES = 5
FRAME_NS = 1_000_000_000 // 60


def weigh(
    settings: Sequence[Setting], calibration: Calibration, images: Sequence[U8], report: Report
) -> list[float]:
    """Peak memory in MiB that each setting, with every output, adds to a process of its own.

    Python, NumPy, OpenCV, ONNX Runtime and the images do not count; the reconstructor's tables and
    networks, and the temporary memory of a step, do. Raises DeviceError (a worker was killed).
    """
    tasks = [(setting, calibration, images) for setting in settings]
    # A process for each: what one has allocated stays, and would hide the next.
    with processes(fresh=True) as workers:
        return list(reported_map(_peak_mib, tasks, workers, report, "settings weighed"))


def _peak_mib(task: tuple[Setting, Calibration, Sequence[U8]]) -> float:
    setting, calibration, images = task
    # ONNX Runtime is part of every process, whatever its settings.
    runtime()  # its import does not count
    # A kernel may not be able to reset the peak; that of the imports is hardly higher.
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    before = _peak_kib()
    made = setting.make(calibration)
    for image in images:
        made.step(Frame(0, 0, 0, setting.image(image)))
    # The peak, because a step takes temporary memory that is free again afterwards.
    return (_peak_kib() - before) / 1024


def _peak_kib() -> int:
    found = re.search(r"^VmHWM:\s+(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1])


class Parts:
    """Processor time in ms of each part of a frame on this thread;
    call it with a part's name at its end.
    """

    def __init__(self) -> None:
        self.ms: dict[str, float] = {}
        # Time of the processor, not of the clock: other programs must not count.
        self._last_ns = time.thread_time_ns()

    def __call__(self, part: str) -> None:
        now_ns = time.thread_time_ns()
        self.ms[part] = (now_ns - self._last_ns) / 1e6
        self._last_ns = now_ns


class Timed:
    """A setting's frames on one thread, and the processor time of each part of them in ms."""

    def __init__(
        self, setting: Setting, need: Need, whole: Calibration, judged: Sequence[JudgedFrames]
    ) -> None:
        self.need = need
        self.contact: list[dict[str, float]] = []
        self.idle: list[dict[str, float]] = []
        self._outputs = [name for name in setting.outputs(whole) if OUTPUTS[name].need in need]
        self._made = setting.make(whole)
        self._t_ns = 0
        self._touched, self._untouched = (
            [setting.image(each.image) for each in judged if each.touched is touched]
            for touched in (True, False)
        )
        # The first frame imports and allocates.
        self._touched = [image for image in self._touched if "depth" in self.frame(image)]
        # Settings get equal time, not equally many frames: fast ones need more of them for a p99.
        usual_ms = sum(self.frame(self._touched[0]).values()) if self._touched else math.inf
        self._count = min(len(self._touched), max(1, int(SLICE_MS / usual_ms)))

    def round(self) -> None:
        """Time the next frames."""
        for images, taken, count in (
            (self._touched, self.contact, self._count),
            (self._untouched, self.idle, IDLE_FRAMES if self._untouched else 0),
        ):
            first = len(taken)
            if count > 1:
                # Warms the caches, which another setting has used meanwhile.
                self.frame(images[first % len(images)])
            taken += [self.frame(images[(first + k) % len(images)]) for k in range(count)]

    def frame(self, image: U8) -> dict[str, float]:
        """Time the stages of a frame's step, then the encoding of each output."""
        # As in a stream, so that work not done on every frame costs as much.
        self._t_ns += FRAME_NS
        parts = Parts()
        result = self._made.step(Frame(0, self._t_ns, 0, image), parts, self.need)
        for name in self._outputs if result is not None and result.contact else ():
            assert result is not None
            OUTPUTS[name].encode(result)
            parts(f"encode {name}")
        return parts.ms
