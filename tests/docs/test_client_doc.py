"""The examples of docs/reference/client.md and docs/how-to/listen.md run,
and the names are public.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import tacshade_client

from support.mqtt_rig import Broker, Subscriber
from support.patience import patience, wait_until
from support.published_sensor import CRC, bump, calibration
from tacshade_edge.wire import binary, messages

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs/reference/client.md").read_text()
LISTEN = (ROOT / "docs/how-to/listen.md").read_text()
HEIGHT = binary.encode_height(bump(7, 2.0, 236.0, 328.0, step_px=8), calibration_crc32=CRC)
pytestmark = pytest.mark.broker


def code_of(text: str) -> str:
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    return str(code)


def test_its_example(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    info = messages.encode_info(
        version="1", config_digest="0", profile="fast", calibration=calibration()
    )
    ended = threading.Event()
    with Broker(tmp_path) as broker, Subscriber(broker.port, "none") as sender:

        def publish() -> None:
            while not ended.wait(0.05):
                sender.publish("tacshade/left-index/height", HEIGHT)

        sender.publish("tacshade/left-index/info", info, retain=True)
        publisher = threading.Thread(target=publish)
        publisher.start()
        try:
            exec(code_of(TEXT).replace("localhost:1883", f"localhost:{broker.port}"), {})
        finally:
            ended.set()
            publisher.join(patience(10))
    assert re.fullmatch(r"[12]\.\d+ \(60, 80, 3\)\n", capsys.readouterr().out)


def test_every_name_is_public() -> None:
    rows = TEXT.partition("| topic | function | value |")[2].partition("\n\n")[0]
    named = set(re.findall(r"`(decode\w*|[A-Z][a-z]+[A-Z]?\w*)`", rows))
    assert {"decode", "HeightMessage", "StitchedMap"} <= named <= set(tacshade_client.__all__)
    assert all(hasattr(tacshade_client, name) for name in tacshade_client.__all__)


def test_the_listener_prints_each_height_map(tmp_path: Path) -> None:
    (tmp_path / "listen.py").write_text(code_of(LISTEN))
    printed = tmp_path / "printed"
    with (
        Broker(tmp_path) as broker,
        Subscriber(broker.port, "none") as publisher,
        printed.open("w") as out,
    ):
        command = [
            sys.executable,
            str(tmp_path / "listen.py"),
            f"127.0.0.1:{broker.port}",
            "left-index",
        ]
        listener = subprocess.Popen(
            command, stdout=out, env=os.environ | {"PYTHONPATH": str(ROOT / "client")}
        )

        def has_printed() -> bool:
            assert listener.poll() is None, "the listener ended"
            publisher.publish("tacshade/left-index/height", HEIGHT)
            return "\n" in printed.read_text()

        try:
            wait_until(has_printed, 20, "the listener prints a line")
        finally:
            listener.terminate()
            listener.wait(patience(10))
    assert re.fullmatch(r"left-index: deepest [12]\.\d\d mm", printed.read_text().splitlines()[0])
