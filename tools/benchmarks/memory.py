"""Measure the daemon's memory: `run` as a service runs it, a broker, and images for a camera.

::

    .venv/bin/python -m tools.benchmarks.memory [--frames 600] [--fps 30]
        [--profile balanced] [--source files] [--json FILE]

The daemon reads 640x480 images of a ball that goes in and out (drawn beforehand by this process),
or draws them itself (``--source simulated``). This process reads its memory from /proc after a
tenth, half and all of the frames:

- resident: all its pages in memory (VmRSS); peak: the maximum so far (VmHWM);
- own: anonymous pages (RssAnon), which the kernel cannot drop;
- files: pages of the program and its libraries, which the kernel can drop and read again.

The largest owners of resident pages follow, from /proc/PID/smaps, and how much memory a process of
this Python gains by importing one library after the other, before the daemon does anything.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from support.mqtt_rig import Broker
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.lab.demo.demo_hand import make_calibration
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.profiles import AUTO, DEFAULT, PROFILES
from tools.testbed.daemon_rig import BASE, FIELDS, draw_rings, memory_mb

TOP = 8
IMPORTS = (
    "sys",
    "ssl",
    "numpy",
    "cv2",
    "onnxruntime",
    "paho.mqtt.client",
    "tacshade_edge.daemon.app",
)
"""What `run` imports, the largest one by one."""
SLOWEST_FPS = 1.0  # the bench gives up on a slower daemon


def owners_mb(pid: int) -> dict[str, float]:
    """Resident MiB by mapped file; ``[anon]`` has no file:
    buffers, thread stacks, Python's objects.
    """
    pages: Counter[str] = Counter()
    owner = ""
    for line in Path(f"/proc/{pid}/smaps").read_text().splitlines():
        words = line.split()
        if re.match(r"[0-9a-f]+-[0-9a-f]+$", words[0]):
            owner = Path(words[5]).name if len(words) > 5 else "[anon]"
        elif words[0] == "Rss:":
            pages[owner] += int(words[1])
    return {name: round(kb / 1024, 1) for name, kb in pages.most_common(TOP)}


def imported_mb() -> list[tuple[str, float, float, float]]:
    """For each of `IMPORTS`, after those before it: its name, and what a fresh process gains by it
    in MiB, resident, own and of files; the first row is Python itself.
    """
    script = (
        "import importlib, re, sys\n"
        "for name in sys.argv[1:]:\n"
        "    importlib.import_module(name)\n"
        "    status = open('/proc/self/status').read()\n"
        "    print(name, *re.findall(r'(?:VmRSS|RssAnon|RssFile):\\s+(\\d+)', status))\n"
    )
    done = subprocess.run(
        (sys.executable, "-c", script, *IMPORTS), stdout=subprocess.PIPE, text=True, check=True
    )
    rows, before = [], np.zeros(3)
    for line in done.stdout.splitlines():
        name, *words = line.split()
        after = np.array(words, float) / 1024
        resident, own, files = (after - before).round(1).tolist()
        rows.append(("Python" if name == "sys" else name, resident, own, files))
        before = after
    return rows


def write_images(folder: Path) -> None:
    """Write the ring as grey PNGs."""
    (folder / "images").mkdir()
    draw_rings(folder)
    for number, image in enumerate(np.load(folder / "contact.npy")):
        cv2.imwrite(str(folder / f"images/{number:03}.png"), image)


class Captured:
    """The number of captured frames that the daemon reports."""

    def __init__(self, port: int) -> None:
        self.frames: dict[str, int] = {}
        self._news = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._on_health
        self._client.connect("127.0.0.1", port)
        self._client.subscribe([(f"{BASE}/health", 0), (f"{BASE}/height", 0)])
        self._client.loop_start()

    def _on_health(self, _client: Client, _data: None, message: MQTTMessage) -> None:
        if message.topic.endswith("health"):
            self.frames = json.loads(message.payload)["frames"]
            self._news.set()

    def wait(self, count: int, daemon: subprocess.Popen[bytes]) -> None:
        """Wait until the daemon has captured `count` frames.

        Raises SystemExit if it ends or is too slow.
        """
        deadline = time.monotonic() + 30 + count / SLOWEST_FPS
        while self.frames.get("captured", 0) < count:
            self._news.clear()
            self._news.wait(1.0)
            if daemon.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"memory: {self.frames} after {count / SLOWEST_FPS + 30:.0f} s")

    def close(self) -> None:
        """Disconnect from the broker."""
        self._client.disconnect()
        self._client.loop_stop()


def measure(folder: Path, config: Path, port: int, frames: int) -> dict[str, Any]:
    """Run the daemon once and return its figures."""
    seen = Captured(port)
    command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
    with (folder / "log").open("w") as log:
        daemon = subprocess.Popen(command, stderr=log, env={**os.environ, "PYTHONUNBUFFERED": "1"})
    try:
        after: dict[int, dict[str, float]] = {}
        for count in (max(frames // 10, 1), frames // 2, frames):
            seen.wait(count, daemon)
            after[count] = memory_mb(daemon.pid)
        owners = owners_mb(daemon.pid)
        daemon.send_signal(signal.SIGTERM)
        code = daemon.wait(20)
    except BaseException:
        print((folder / "log").read_text(), file=sys.stderr)
        raise
    finally:
        daemon.kill()
        daemon.wait()
        seen.close()
    return {"exit": code, "frames": seen.frames, "after": after, "owners_mb": owners}


def main() -> int:
    """Measure and print; return 1 if the daemon did not exit cleanly."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=600)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--profile", choices=[*PROFILES, AUTO], default=DEFAULT)
    parser.add_argument("--source", choices=("files", "simulated"), default="files")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calibration_file.save(folder / "c.npz", make_calibration())
        write_images(folder)
        source = f"{{kind: {args.source}, fps: {args.fps}}}"
        if args.source == "files":
            source = f"{{kind: files, path: images, fps: {args.fps}, loop: true}}"
        with Broker(folder) as broker:
            config = folder / "config.yaml"
            config.write_text(
                f"sensor_id: bench\nprofile: {args.profile}\ncalibration: c.npz\nsource: {source}\n"
                f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
                + "latency_budget_ms: 50\n"
                * (args.profile == AUTO)
            )
            result = measure(folder, config, broker.port, args.frames)
    after = [
        [str(count), *(f"{memory[name]:.1f}" for name in FIELDS)]
        for count, memory in result["after"].items()
    ]
    print(markdown(["frames", *(f"{name} MB" for name in FIELDS)], after))
    print(
        "\nlargest owners, MB: "
        + ", ".join(f"{owner} {mb}" for owner, mb in result["owners_mb"].items())
    )
    print(f"frames: {result['frames']}\n")
    rows = [[name, *(f"{mb:.1f}" for mb in gained)] for name, *gained in imported_mb()]
    print(markdown(["imported", "resident MB", "own MB", "files MB"], rows))
    if args.json:
        args.json.write_text(json.dumps(result, indent=1) + "\n")
    return 0 if result["exit"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
