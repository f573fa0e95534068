"""The daemon in a thread, with what its tests say to it and hear of it."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from support.mqtt_rig import Broker, Subscriber
from support.patience import patience, wait_until
from tacshade_edge.daemon.app import App
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.pipeline.ledger import Counts
from tacshade_edge.reasons import Reason
from tacshade_edge.settings import Document, load
from tacshade_edge.types import U8, Calibration

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


def switched(pictures: Any, touch: threading.Event) -> Iterator[Any]:
    """Free until it is touched."""
    while True:
        yield from paced(pictures.touched if touch.is_set() else pictures.free, 1)


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
    """An app in a thread of its own; `end` stops it and returns how long that took."""

    def __init__(self, settings: Document, source: Any, calibration: Calibration | Reason) -> None:
        self.app = App(settings, source, calibration)
        self.error: BaseException | None = None
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        try:
            self.app.run()
        except (ConfigError, ZeroDivisionError) as error:
            self.error = error

    def __enter__(self) -> Running:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> float:
        began = time.monotonic()
        self.app.stop()
        self.join()
        return time.monotonic() - began

    def join(self) -> None:
        self._thread.join(patience(20))
        assert not self._thread.is_alive()

    def counts(self) -> Counts:
        return self.app.ledger.counts()


class Live:
    """A broker, daemons on it whose cameras the test scripts,
    and what a subscriber hears of them.
    """

    def __init__(
        self, folder: Path, broker: Broker, seen: Subscriber, calibration: Calibration
    ) -> None:
        self.folder, self.broker, self.seen, self.calibration = folder, broker, seen, calibration

    def document(self, more: str = "") -> Document:
        return document(self.folder, self.broker.port, more)

    def run(
        self,
        source: Any,
        settings: Document | str = "",
        calibration: Calibration | Reason | None = None,
    ) -> Running:
        known = settings if isinstance(settings, Document) else self.document(settings)
        return Running(known, source, self.calibration if calibration is None else calibration)

    def payloads(self, topic: str) -> list[bytes]:
        return self.seen.of(f"{BASE}/{topic}")

    def states(self) -> list[str]:
        return [payload.decode() for payload in self.payloads("state")]

    def last(self, topic: str) -> Any:
        payloads = self.payloads(topic)
        return json.loads(payloads[-1]) if payloads else {}

    def until(self, topic: str, what: str = "", seconds: float = 15, **wanted: Any) -> Any:
        """Wait for a message of a topic with these values, and return it."""

        def there() -> bool:
            latest = self.last(topic)
            return bool(latest) and all(latest.get(key) == value for key, value in wanted.items())

        wait_until(there, seconds, f"{topic}: {what or wanted}")
        return self.last(topic)

    def until_state(self, state: str) -> None:
        wait_until(lambda: self.states()[-1:] == [state], 15, state)

    def ask(self, verb: str, **body: Any) -> Any:
        """The reply to one request."""
        topic = f"{BASE}/res/{verb}"
        before = len(self.seen.of(topic))
        self.seen.publish(
            f"{BASE}/req/{verb}", json.dumps({"transaction": f"t{before}", **body}).encode()
        )
        answer = json.loads(self.seen.wait_for(topic, before + 1, 15)[-1])
        assert answer.pop("transaction") == f"t{before}"
        return answer


def assert_accounted(frames: dict[str, int]) -> None:
    """Every frame has one outcome."""
    assert frames["pending"] == 0
    assert frames["captured"] == sum(count for name, count in frames.items() if name != "captured")
