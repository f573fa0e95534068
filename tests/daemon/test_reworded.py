"""The daemon decides by the code of a reason, never by its text."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from support.reworded import NONSENSE, reword

from tacshade_edge.daemon import app as app_module
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.profiles.profile_chooser import ProfileChooser
from tacshade_edge.devices.mqtt.link import MqttLink
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.factories import links
from tacshade_edge.factories.links import make_link
from tacshade_edge.protocol.requests import Request, parse_request
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.settings import Document, load
from tacshade_edge.types import Calibration
from tools.testbed.mqtt_rig import free_port
from tools.testbed.patience import patience, wait_until


class Observed:
    """A daemon without a broker, and all that it would publish."""

    def __init__(self, folder: Path, source: Any, calibration: Calibration, monkeypatch: pytest.MonkeyPatch) -> None:
        settings = folder / "settings.yaml"
        broker = f"mqtt: {{host: 127.0.0.1, port: {free_port()}}}"
        settings.write_text(f"source: {{kind: simulated}}\nrecorder: {{folder: recs}}\n{broker}\n")
        self.values: list[tuple[str, dict[str, Any]]] = []
        self.replies: list[dict[str, Any]] = []
        monkeypatch.setattr(links, "make_link", self._make_link)
        self.app = App(load(settings), source, calibration)
        self.thread = threading.Thread(target=self.app.run, daemon=True)
        self.thread.start()

    def _make_link(self, document: Document, **calls: Any) -> MqttLink:
        link = make_link(document, **calls)
        publish = link.set_retained

        def set_retained(topic: str, payload: bytes, **options: Any) -> None:
            publish(topic, payload, **options)
            if topic == "state":
                self.values.append((topic, {"state": payload.decode()}))
            elif topic.startswith("status/"):
                self.values.append((topic, json.loads(payload)))

        link.set_retained = set_retained  # type: ignore[method-assign]
        link.reply = lambda _, payload: self.replies.append(json.loads(payload))  # type: ignore[method-assign]
        return link

    def ask(self, verb: Any, **fields: Any) -> None:
        self.app._on_request(Request(verb, **fields))

    def latest(self, topic: str) -> dict[str, Any]:
        return next((value for name, value in reversed(self.values) if name == topic), {})

    def decisions(self) -> dict[str, Any]:
        """Every state with its code in the order of each topic, and the replies without their texts."""
        found: dict[str, Any] = {}
        for topic in ("state", "status/camera", "status/recorder"):
            states = [(value["state"], value.get("reason_code")) for name, value in self.values if name == topic]
            found[topic] = [state for state, _ in groupby(states)]
        found["replies"] = [{**reply, "error": None, "result": bool(reply.get("result"))} for reply in self.replies]
        return found


def a_day(folder: Path, calibration: Calibration, pictures: Any, scripted: Any, patch: pytest.MonkeyPatch) -> Observed:
    """Frames, darkness, light again, a recording whose folder goes away, a camera that goes away, the end."""
    folder.mkdir()
    dark, light, lost, end, pause = (threading.Event() for _ in range(5))

    def paced(picture: Any, until: threading.Event) -> Iterator[Any]:
        while not until.is_set():
            yield picture
            yield lambda: pause.wait(0.01)

    def first() -> Iterator[Any]:
        for picture, until in ((pictures.free, dark), (pictures.black, light), (pictures.free, lost)):
            yield from paced(picture, until)
        yield DecodeError("frame 9: cut")
        yield DeviceError("camera: gone", code=ReasonCode.LOST)

    def second() -> Iterator[Any]:
        yield from paced(pictures.free, end)
        yield None

    daemon = Observed(folder, scripted(first(), second()), calibration, patch)
    recorder = "status/recorder"
    try:
        wait_until(lambda: daemon.latest("state").get("state") == "online")
        daemon.ask("profile", profile="slow")
        daemon.ask("record", action="stop")
        dark.set()
        wait_until(lambda: daemon.latest("status/camera")["state"] == "unusable")
        light.set()
        wait_until(lambda: daemon.latest("status/camera")["state"] == "streaming")
        daemon.ask("record", action="start", seconds=600, name="one")
        wait_until(lambda: daemon.latest(recorder).get("frames", 0) > 0)
        daemon.ask("record", action="start", seconds=600, name="two")
        wait_until(lambda: len(daemon.replies) == 4)
        (folder / "recs" / "one").rename(folder / "recs" / "gone")
        wait_until(lambda: daemon.latest(recorder)["state"] == "stopped")
        daemon.ask("record", action="start", seconds=600, name="three")
        wait_until(lambda: daemon.latest(recorder)["state"] == "recording")
        daemon.ask("record", action="stop")
        wait_until(lambda: daemon.latest(recorder)["state"] == "idle")
        lost.set()
        wait_until(lambda: ("status/camera", "lost") in [(n, v.get("reason_code")) for n, v in daemon.values])
        wait_until(lambda: daemon.latest("status/camera")["state"] == "streaming")
        end.set()
        wait_until(lambda: daemon.latest("status/camera")["state"] == "ended")
    finally:
        daemon.app.stop()
        daemon.thread.join(patience(20))
    assert not daemon.thread.is_alive()
    return daemon


@pytest.mark.slow
def test_rewording_every_message_changes_no_decision(
    tmp_path: Path, calibration: Calibration, pictures: Any, scripted: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "HEALTH_PERIOD_S", 0.1)
    before = a_day(tmp_path / "before", calibration, pictures, scripted, monkeypatch)
    reword(monkeypatch)
    after = a_day(tmp_path / "after", calibration, pictures, scripted, monkeypatch)
    assert after.decisions() == before.decisions()
    assert [state for state, _ in before.decisions()["status/camera"]] == [
        *("away", "streaming", "unusable", "streaming", "away", "streaming", "ended")
    ]
    assert before.decisions()["status/recorder"][-3:] == [("stopped", "disk"), ("recording", ""), ("idle", "")]
    texts = {value["reason"] for name, value in after.values if name != "state"}
    assert texts == {"", NONSENSE}
    assert NONSENSE not in {value["reason"] for name, value in before.values if name != "state"}


def test_a_reworded_step_of_auto(monkeypatch: pytest.MonkeyPatch) -> None:
    def steps() -> list[tuple[str, bool]]:
        chooser = ProfileChooser(20.0, {"accurate": 10.0, "balanced": 5.0, "fast": 2.0})
        made = []
        for frame in range(6000):
            load = 3.0 if 60 <= frame < 300 else 1.0
            own_ms = load * {"accurate": 10.0, "balanced": 5.0, "fast": 2.0}[chooser.profile]
            if step := chooser.observe(chooser.profile, frame / 30, own_ms + 3, own_ms):
                made.append((step.profile, step.up))
        return made

    before = steps()
    reword(monkeypatch)
    assert steps() == before
    assert {up for _, up in before} == {True, False}


def test_a_reworded_request_that_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    reword(monkeypatch)
    for verb, payload in (("fly", b""), ("profile", b"{}"), ("status", b"x" * 9999)):
        with pytest.raises(DecodeError) as caught:
            parse_request(verb, payload)
        assert caught.value.reason.code is ReasonCode.BAD_REQUEST
        assert str(caught.value) == NONSENSE
