#!/usr/bin/env python3
"""Stop the daemon at random moments while every core is busy; report its exit codes and how long it took.

::

    .venv/bin/python -m tools.benchmarks.stops [--stops 200] [--seed 0] [--python PROGRAM]

Each daemon runs on the simulated sensor with the profile ``accurate`` and a broker, next to one busy process for each
core. It gets SIGTERM after 0 to 6 s, evenly spread: while it starts and while it streams, in contact and not. Before
the interpreter reaches the program's first lines the kernel ends it (-15): these stops are counted separately, and
systemd takes them as clean too. `--python` is the interpreter of another checkout's `.venv`, to compare. The exit code
is 1 if any other exit code was not 0.

With systemd and a camera, in the guest: ``TACSHADE_STOPS=20 .venv/bin/python -m pytest tests/guest/test_service.py``.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.daemon_rig import broker

LONGEST_S = 6.0
HANGS_S = 60.0


def stop(command: list[str], after_s: float) -> tuple[str, int, float, str]:
    """Phase, exit code, seconds from SIGTERM to the end, and output."""
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as daemon:
        threading.Event().wait(after_s)
        begun = catches_sigterm(daemon.pid)
        began_s = time.monotonic()
        daemon.send_signal(signal.SIGTERM)
        try:
            _, said = daemon.communicate(timeout=HANGS_S)
        except subprocess.TimeoutExpired:
            daemon.kill()
            _, said = daemon.communicate()
        phase = "running" if "source streaming" in said else "starting" if begun else "interpreter"
        return phase, daemon.returncode, time.monotonic() - began_s, said


def catches_sigterm(pid: int) -> bool:
    """Whether the process has a handler for SIGTERM."""
    found = re.search(r"^SigCgt:\s*(\w+)$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    return found is not None and bool(int(found[1], 16) >> (signal.SIGTERM - 1) & 1)


def main() -> int:
    """Stop the given number of daemons and print a row for each phase."""
    parser = argparse.ArgumentParser(description="Stop the daemon at random moments under full load.")
    parser.add_argument("--stops", type=int, default=200, metavar="N")
    parser.add_argument("--seed", type=int, default=0, metavar="N")
    parser.add_argument("--python", default=sys.executable, metavar="PROGRAM")
    args = parser.parse_args()
    draw = random.Random(args.seed)
    phases: dict[str, list[tuple[int, float]]] = {"interpreter": [], "starting": [], "running": []}
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        port = stack.enter_context(broker(folder))
        calibration_file.save(folder / "c.npz", make_calibration())
        settings = folder / "settings.yaml"
        settings.write_text(
            "calibration: c.npz\nprofile: accurate\nsource: {kind: simulated, fps: 60}\n"
            f"mqtt: {{host: 127.0.0.1, port: {port}}}\n"
        )
        for _ in range(os.cpu_count() or 1):
            busy = stack.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            stack.callback(busy.kill)
        for number in range(args.stops):
            command = [args.python, "-m", "tacshade_edge", "run", "--config", str(settings)]
            phase, code, took_s, said = stop(command, draw.uniform(0, LONGEST_S))
            phases[phase].append((code, took_s))
            if code and phase != "interpreter":
                print(f"stop {number}: exit {code} after {took_s:.2f} s: {said.strip()[-300:]}", flush=True)
    print("phase        stops   s p50   p99   most   exit codes")
    for phase, ends in phases.items():
        all_s = np.array([seconds for _, seconds in ends] or [np.nan])
        figures = f"{np.median(all_s):6.2f} {np.quantile(all_s, 0.99):5.2f} {all_s.max():6.2f}"
        print(f"{phase:12} {len(ends):5}  {figures}   {dict(Counter(code for code, _ in ends))}")
    return int(any(code for phase, ends in phases.items() if phase != "interpreter" for code, _ in ends))


if __name__ == "__main__":
    sys.exit(main())
