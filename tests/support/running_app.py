"""The daemon in a thread, with what its tests say to it and hear of it."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tacshade_edge.daemon.app import App
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.settings import Document, load
from tacshade_edge.types import U8, Calibration
from tools.testbed.mqtt_rig import Subscriber
from tools.testbed.patience import patience

BASE = "tacshade/hand-1"


NO_REASON = {"reason": "", "reason_code": ""}


GONE = DeviceError("camera /dev/video9: gone")


STOP_S = 2.0


def paced(image: U8, frames: int | None = None, period_s: float = 0.02) -> Iterator[Any]:
    """`frames` (None: for ever) of one picture at 50 per second."""
    pause = threading.Event()
    sent = 0
    while frames is None or sent < frames:
        yield image
        yield lambda: pause.wait(period_s)
        sent += 1


def document(folder: Path, port: int, more: str = "") -> Document:
    path = folder / "settings.yaml"
    if "calibration:" not in more:  # never the machine's own
        more += "calibration: calibration.npz\n"
    path.write_text(
        f"sensor_id: hand-1\nsource: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
        f"recorder: {{folder: recs}}\n{more}",
        encoding="utf-8",
    )
    return load(path)


class Running:
    """An app in a thread of its own; `end` stops it and tells how long that took."""

    def __init__(self, settings: Document, source: Any, calibration: Calibration) -> None:
        self.app = App(settings, source, calibration)
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.app.run()
        except (ConfigError, ZeroDivisionError) as error:
            self.error = error

    def end(self) -> float:
        began = time.monotonic()
        self.app.stop()
        return self.join() - began

    def join(self) -> float:
        self._thread.join(patience(20))
        assert not self._thread.is_alive()
        return time.monotonic()


def states(seen: Subscriber) -> list[str]:
    return [payload.decode() for payload in seen.of(f"{BASE}/state")]


def last(seen: Subscriber, topic: str) -> Any:
    payloads = seen.of(f"{BASE}/{topic}")
    return json.loads(payloads[-1]) if payloads else {}


def ask(seen: Subscriber, verb: str, **body: Any) -> Any:
    """The reply to one request."""
    topic = f"{BASE}/res/{verb}"
    before = len(seen.of(topic))
    seen.publish(f"{BASE}/req/{verb}", json.dumps({"transaction": f"t{before}", **body}).encode())
    answer = json.loads(seen.wait_for(topic, before + 1, 10)[-1])
    assert answer.pop("transaction") == f"t{before}"
    return answer


def assert_accounted(frames: dict[str, int]) -> None:
    assert frames["pending"] == 0
    parts = ("published", "superseded", "without_contact", "unasked", "invalid", "failed")
    assert frames["captured"] == sum(frames[name] for name in parts)
