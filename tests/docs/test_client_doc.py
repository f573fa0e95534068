"""docs/reference/client.md: its example runs, and every name in it is public."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import pytest
import tacshade_client
from support.published_sensor import CRC, bump, calibration

from tacshade_edge.protocol import messages, wire
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.patience import patience

TEXT = (Path(__file__).parents[2] / "docs/reference/client.md").read_text()


@pytest.mark.broker
@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_its_example(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    info = messages.encode_info(version="1", config_digest="0", profile="fast", calibration=calibration())
    height = wire.encode_height(bump(7, 2.0, 236.0, 328.0, step_px=8), calibration_crc32=CRC)
    ended = threading.Event()
    with Broker(tmp_path) as broker, Subscriber(broker.port, "none") as sender:

        def publish() -> None:
            while not ended.wait(0.05):
                sender.publish("tacshade/left-index/height", height)

        sender.publish("tacshade/left-index/info", info, retain=True)
        publisher = threading.Thread(target=publish)
        publisher.start()
        try:
            exec(code.replace("localhost:1883", f"localhost:{broker.port}"), {})
        finally:
            ended.set()
            publisher.join(patience(10))
    assert re.fullmatch(r"[12]\.\d+ \(60, 80, 3\)\n", capsys.readouterr().out)


def test_every_name_is_public() -> None:
    rows = TEXT.partition("| topic | function | value |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(decode\w*|[A-Z][a-z]+[A-Z]?\w*)`", rows))
    assert {"decode", "HeightMessage", "StitchedMap"} <= named <= set(tacshade_client.__all__)
    assert all(hasattr(tacshade_client, name) for name in tacshade_client.__all__)
