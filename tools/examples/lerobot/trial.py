#!/usr/bin/env python3
"""Run `record` with a daemon on the simulated sensor, through mosquitto.

::

    .venv/bin/python -m tools.examples.lerobot.trial --python ENV/bin/python [--seconds 20]

ENV is a separate environment for LeRobot, which pins another OpenCV than this project; it also needs
`pip install ./client ./client_lerobot`.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from tacshade_edge.demo.hand import make_calibration
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import Broker

RECORD = Path(__file__).parent / "record.py"
SENSOR_ID = "left-index"
SETTINGS = """\
sensor_id: {sensor_id}
calibration: cal.npz
source: {{kind: simulated, fps: 15}}
mqtt: {{host: 127.0.0.1, port: {port}}}
"""


def main() -> int:
    """Calibrate the simulated sensor, run its daemon, and record."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--python", type=Path, required=True, help="that has LeRobot and the plugin")
    parser.add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, Broker(Path(name)) as broker:
        folder = Path(name)
        calibration_file.save(folder / "cal.npz", make_calibration())
        (folder / "config.yaml").write_text(SETTINGS.format(sensor_id=SENSOR_ID, port=broker.port))
        command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(folder / "config.yaml")]
        daemon = subprocess.Popen(command)
        try:
            words = [str(args.python), str(RECORD), f"127.0.0.1:{broker.port}", SENSOR_ID]
            words += ["--root", str(folder / "touch"), "--seconds", str(args.seconds)]
            return subprocess.run(words, check=False).returncode
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait()


if __name__ == "__main__":
    sys.exit(main())
