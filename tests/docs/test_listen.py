"""The lines of docs/how-to/listen.md print what a daemon publishes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.protocol import wire
from tacshade_edge.types import HeightMap, ObjectCloud, Reconstruction
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import patience, wait_until

ROOT = Path(__file__).parents[2]
LISTEN = (ROOT / "docs/how-to/listen.md").read_text()


@pytest.mark.broker
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_the_listener_prints_each_height_map(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", LISTEN, re.DOTALL)
    assert len([line for line in code.splitlines() if line and not line.startswith(("import", "from"))]) <= 2
    (tmp_path / "listen.py").write_text(code)
    height = np.full((5, 7), np.nan, np.float32)
    height[1:4, 2:6] = 0.25
    height[2, 3] = 2.5
    grid = HeightMap(height, height > 0, 0.0, 0.0, 4.0)
    nothing = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
    payload = wire.encode_height(
        Reconstruction(1, 1, 1, "fast", True, None, True, False, None, grid, nothing), calibration_crc32=1
    )
    topic = "tacshade/left-index/height"
    printed = tmp_path / "printed"
    with Broker(tmp_path) as broker, Subscriber(broker.port, "none") as publisher, printed.open("w") as out:
        command = [sys.executable, str(tmp_path / "listen.py"), f"127.0.0.1:{broker.port}", "left-index"]
        listener = subprocess.Popen(command, stdout=out, env=os.environ | {"PYTHONPATH": str(ROOT / "client")})
        try:

            def has_printed() -> bool:
                assert listener.poll() is None, "the listener ended"
                publisher.publish(topic, payload)
                return "\n" in printed.read_text()

            wait_until(has_printed, 20, "the listener prints a line")
        finally:
            listener.terminate()
            listener.wait(patience(10))
    assert printed.read_text().splitlines()[0] == "left-index: deepest 2.50 mm"
