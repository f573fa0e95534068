"""What the daemon's benches share: the images of a camera that costs nothing,
and figures of a process.
"""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import numpy as np

RING = 32
BASE = "tacshade/bench"
FIELDS = {"resident": "VmRSS", "own": "RssAnon", "files": "RssFile", "peak": "VmHWM"}


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


def family(pid: int) -> list[int]:
    """Ids of a process and its children."""
    found = subprocess.run(("pgrep", "-P", str(pid)), capture_output=True, check=False).stdout
    return [pid, *map(int, found.split())]
