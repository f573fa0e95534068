#!/usr/bin/env python3
"""Run `record` or LeRobot's own `lerobot-record` with mosquitto and a simulated sensor's daemon.

::

    .venv/bin/python -m tools.examples.lerobot.trial --python ENV/bin/python
        [--seconds 20] [--lerobot-record FOLDER]

ENV is a separate environment for `lerobot[core-scripts]`, which pins another OpenCV than this
project; it also needs `pip install ./client ./client_lerobot`.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from support.mqtt_rig import Broker
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.lab.demo.demo_hand import make_calibration

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
    parser.add_argument(
        "--python", type=Path, required=True, help="that has LeRobot and the plugin"
    )
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument(
        "--lerobot-record",
        type=Path,
        metavar="FOLDER",
        help="record two episodes into a new folder",
    )
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, Broker(Path(name)) as broker:
        folder = Path(name)
        calibration_file.save(folder / "cal.npz", make_calibration())
        (folder / "config.yaml").write_text(SETTINGS.format(sensor_id=SENSOR_ID, port=broker.port))
        command = [
            sys.executable,
            "-m",
            "tacshade_edge",
            "run",
            "--config",
            str(folder / "config.yaml"),
        ]
        daemon = subprocess.Popen(command)
        try:
            words = [str(args.python), str(RECORD), f"127.0.0.1:{broker.port}", SENSOR_ID]
            words += ["--root", str(folder / "touch"), "--seconds", str(args.seconds)]
            if args.lerobot_record:
                words = by_lerobot(
                    args.python, folder, broker.port, args.lerobot_record, args.seconds
                )
            return subprocess.run(
                words, env={**os.environ, "PYTHONPATH": name}, check=False
            ).returncode
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.wait()


def by_lerobot(python: Path, folder: Path, port: int, root: Path, seconds: float) -> list[str]:
    """Put `still_robot` into a folder under the name that LeRobot looks for;
    the command that records with it.
    """
    about = folder / "lerobot_robot_still-0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: lerobot_robot_still\nVersion: 0\n"
    )
    shutil.copy(RECORD.with_name("still_robot.py"), folder / "lerobot_robot_still.py")
    camera = (
        f'{{touch: {{type: tacshade, broker: "127.0.0.1:{port}", sensor: {SENSOR_ID}, use_depth: '
        "true}}"
    )
    words: dict[str, object] = {
        "robot.type": "still",
        "robot.cameras": camera,
        "teleop.type": "still",
    }
    words |= {
        "dataset.repo_id": "tacshade/still",
        "dataset.root": root,
        "dataset.single_task": "be touched",
    }
    words |= {
        "dataset.video": "false",
        "dataset.fps": 5,
        "dataset.episode_time_s": seconds / 2,
        "dataset.reset_time_s": 1,
    }
    words |= {"dataset.num_episodes": 2, "dataset.push_to_hub": "false", "play_sounds": "false"}
    return [
        str(python.with_name("lerobot-record")),
        *(f"--{key}={value}" for key, value in words.items()),
    ]


if __name__ == "__main__":
    sys.exit(main())
