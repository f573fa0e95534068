"""What the daemon's benches share: a camera that costs nothing, its images,
and figures of a process.
"""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import numpy as np

from tacshade_edge.types import U8, Frame

RING = 32
BASE = "tacshade/bench"
FIELDS = {"resident": "VmRSS", "own": "RssAnon", "files": "RssFile", "peak": "VmHWM"}


class RingSource:
    """A `FrameSource` that cycles through images of a file, uint8 (N, H, W);
    it drops late ones, as a camera does.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self._images: U8 = np.asarray(
            np.load(path, mmap_mode="r")
        )  # mapped: its pages are counted separately
        self._period_ns = round(1e9 / fps)
        self._zero_ns = self._next_seq = 0
        self.dropped = 0

    def open(self) -> None:
        """Start the clock."""
        self._zero_ns = time.monotonic_ns() - self._next_seq * self._period_ns

    def read(self) -> Frame:
        """Wait until the next frame is due; its time stamp is that time."""
        seq, t_ns = self._wait()
        wall_ns = time.time_ns() - (time.monotonic_ns() - t_ns)
        return Frame(
            seq=seq, t_ns=t_ns, wall_ns=wall_ns, image=self._images[seq % len(self._images)]
        )

    def skip(self) -> bool:
        """Wait until the next frame is due."""
        self._wait()
        return True

    def _wait(self) -> tuple[int, int]:
        missed = max((time.monotonic_ns() - self._zero_ns) // self._period_ns - self._next_seq, 0)
        self.dropped += missed
        seq = self._next_seq + missed
        self._next_seq = seq + 1
        t_ns = self._zero_ns + seq * self._period_ns
        time.sleep(max(t_ns - time.monotonic_ns(), 0) / 1e9)
        return seq, t_ns

    def close(self) -> None:
        """Nothing to release."""

    def describe(self) -> dict[str, str | int | float]:
        """Describe the source."""
        return {"device": "ring", "images": len(self._images)}


def draw_rings(folder: Path) -> None:
    """Write the images of a ball that goes in and out, halfway in at first,
    and of the untouched skin.

    ``contact.npy`` and ``free.npy`` have one channel, as a camera's frames have;
    ``colour.npy`` is the first as drawn.
    """
    # Here, since a daemon that imports this module draws nothing.
    from tacshade_edge.lab.simulator.press import Press, ball
    from tacshade_edge.lab.simulator.script import Script
    from tacshade_edge.lab.simulator.truth import SimulatedSensor

    script = Script(
        (Press(ball(6.0), 1.0, -2.0, 3.5),), approach=RING // 2 - 1, hold=8, release=8, pause=1
    )
    sensor = SimulatedSensor(None)
    shown = [
        sensor.frame(script.at((RING // 4 + i) % RING), noise_seed=i).image for i in range(RING)
    ]
    free = [sensor.frame(noise_seed=RING + i).image for i in range(RING)]
    for name, images in (("contact", shown), ("free", free)):
        np.save(folder / f"{name}.npy", np.stack(images)[..., 1])
    np.save(folder / "colour.npy", np.stack(shown))


def memory_mb(pid: int) -> dict[str, float]:
    """`FIELDS` of a process in MiB, without the images of a `RingSource`:
    a camera's images take no memory.
    """
    status = Path(f"/proc/{pid}/status").read_text()
    found = {
        name: re.search(rf"^{key}:\s+(\d+) kB$", status, re.MULTILINE)
        for name, key in FIELDS.items()
    }
    images_mb = _mapped_mb(pid, "Rss", images=True)
    shown_mb = dict.fromkeys(FIELDS, images_mb) | {"own": 0.0}
    return {
        name: round(int(match[1]) / 1024 - shown_mb[name], 1)
        for name, match in found.items()
        if match
    }


def pss_mb(pid: int) -> float:
    """Proportional set size of a process in MiB, without the images of a `RingSource`."""
    return _mapped_mb(pid, "Pss", images=False)


def _mapped_mb(pid: int, field: str, images: bool) -> float:
    """Sum in MiB of a field of /proc/PID/smaps over the mappings of images, or over all others."""
    found, ours = 0, False
    for line in Path(f"/proc/{pid}/smaps").read_text().splitlines():
        name, _, rest = line.partition(":")
        if name == field:
            found += int(rest.split()[0]) if ours else 0
        elif "-" in line.split(" ", 1)[0]:
            ours = line.endswith(".npy") is images
    return found / 1024


def cpu_s(pid: int) -> float:
    """Processor time in s that a process has used in all its threads."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
