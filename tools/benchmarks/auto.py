"""Watch `auto` under load: the daemon runs on pre-rendered frames while busy processes compete with it for a time.

::

    .venv/bin/python -m tools.benchmarks.auto --budget-ms 10 [--fps 60] [--idle 10] [--load 30] [--after 90]
        [--processes 4]

The processes multiply matrices in an endless loop. Every second one line shows the last `health`; another line shows
each change of profile in `info`. The frames are those of `tools.benchmarks.daemon`: 640x480, nearly all in contact.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.storage.calibration import calibration_file
from tools.benchmarks.daemon import RING_DAEMON
from tools.testbed.daemon_rig import BASE, broker, draw_rings

BUSY = "import numpy\na = numpy.random.rand(200, 200)\nwhile True: a @ a"


class Told:
    """Prints the daemon's reports with the seconds since the start."""

    def __init__(self, port: int) -> None:
        self._began_s = time.monotonic()
        self._profile = ""
        self.phase = "idle"
        self.first = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._on_message
        self._client.connect("127.0.0.1", port)
        self._client.subscribe([(f"{BASE}/health", 0), (f"{BASE}/info", 1)])
        self._client.loop_start()

    def _on_message(self, _client: Client, _data: None, message: MQTTMessage) -> None:
        at = f"{time.monotonic() - self._began_s:6.1f} s  {self.phase:<6}"
        told = json.loads(message.payload)
        if message.topic.endswith("info"):
            if told["profile"] != self._profile:
                self._profile = told["profile"]
                print(f"{at}  info: profile {self._profile}", flush=True)
            return
        if not (budget := told.get("budget")):
            return
        self.first.set()
        kept = {True: "kept", False: "not kept", None: "too few frames"}[budget["kept"]]
        print(
            f"{at}  {budget['profile']:<9} p90 {budget['p90_ms'] or float('nan'):6.1f} ms  {kept:<14}"
            f"{told['delivered_fps']:5.1f} fps  {budget['steps_down']} down, {budget['steps_up']} up",
            flush=True,
        )

    def close(self) -> None:
        """Disconnect from the broker."""
        self._client.disconnect()
        self._client.loop_stop()


def main() -> int:
    """Run once; return 1 if the daemon did not exit cleanly."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--budget-ms", type=float, required=True)
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument("--idle", type=float, default=10.0, metavar="SECONDS", help="before the load")
    parser.add_argument("--load", type=float, default=30.0, metavar="SECONDS")
    parser.add_argument("--after", type=float, default=90.0, metavar="SECONDS")
    parser.add_argument("--processes", type=int, default=2 * (os.cpu_count() or 1), help="twice the processors")
    args = parser.parse_args()
    pause = threading.Event()
    busy: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calibration_file.save(folder / "c.npz", make_calibration())
        draw_rings(folder)
        with broker(folder) as port:
            config = folder / "config.yaml"
            config.write_text(
                f"sensor_id: bench\nprofile: auto\nlatency_budget_ms: {args.budget_ms}\ncalibration: c.npz\n"
                f"source: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
            )
            told = Told(port)
            words = [sys.executable, "-m", RING_DAEMON, str(config), str(folder / "contact.npy"), str(args.fps)]
            daemon = subprocess.Popen(words, stdout=subprocess.DEVNULL)
            try:
                if not told.first.wait(60):
                    raise SystemExit("auto: found no health with a budget within 60 s")
                pause.wait(args.idle)
                told.phase = "load"
                busy += [subprocess.Popen([sys.executable, "-c", BUSY]) for _ in range(args.processes)]
                pause.wait(args.load)
                for process in busy:
                    process.kill()
                told.phase = "after"
                pause.wait(args.after)
                daemon.send_signal(signal.SIGTERM)
                return 0 if daemon.wait(20) == 0 else 1
            finally:
                for process in (*busy, daemon):
                    process.kill()
                    process.wait()
                told.close()


if __name__ == "__main__":
    sys.exit(main())
