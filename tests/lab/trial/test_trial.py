"""The daemon on trial, through real brokers."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.mqtt_rig import Broker, Subscriber
from support.painted_sensor import FREE, TOUCHED, painted_calibration
from tacshade_edge.errors import DeviceError
from tacshade_edge.lab.demo import child
from tacshade_edge.lab.studies.tradeoff.measure import Promise
from tacshade_edge.lab.trial import trial
from tacshade_edge.lab.trial.trial import TrialBroker, Wanted, try_daemon
from tacshade_edge.settings import load


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "SECONDS", 1.0)
    monkeypatch.setattr(trial, "LEAST_FRAMES", 1)


def wanted(fingers: int) -> Wanted:
    images = [TOUCHED, TOUCHED, FREE]
    return Wanted(
        profile="fast",
        calibration=painted_calibration(),
        images=images,
        fps=20,
        fingers=fingers,
        outputs=("height", "contact"),
    )


def of_daemon(promise: Promise) -> None:
    assert 0 < promise.p50_ms <= promise.p99_ms
    assert 0 <= promise.lost <= promise.frames
    assert promise.control_p99_ms > 0


@pytest.mark.broker
@pytest.mark.slow
@pytest.mark.usefixtures("short")
class TestTrial:
    def test_a_hand_is_tried_through_a_private_broker(self) -> None:
        with TrialBroker(None) as broker:
            promise = try_daemon(wanted(2), broker, 1.0)
        of_daemon(promise)
        assert promise.through == "a private broker"

    def test_nothing_stays_on_the_broker_that_settings_name(self, tmp_path: Path) -> None:
        word = tmp_path / "word"
        word.write_text("secret\n")
        with Broker(tmp_path, users={"robot": "secret"}) as broker:
            path = tmp_path / "config.yaml"
            path.write_text(
                "calibration: c.npz\nsource: {kind: simulated}\n"
                f"mqtt: {{host: 127.0.0.1, port: {broker.port}, username: robot,"
                f" password_file: {word}}}\n"
            )
            with TrialBroker(load(path)) as named:
                promise = try_daemon(wanted(1), named, 1.0)
            of_daemon(promise)
            assert promise.through == f"127.0.0.1:{broker.port}"
            seen = Subscriber(broker.port)
            seen.client.username_pw_set("robot", "secret")
            with seen:
                # Retained messages come before what is published after the subscription.
                seen.publish("last", b"")
                seen.wait_for("last")
            assert [message.topic for message in seen.messages] == ["last"]

    def test_a_broker_that_rejects_is_one_line(self, tmp_path: Path) -> None:
        with Broker(tmp_path, users={"robot": "secret"}) as broker:
            path = tmp_path / "config.yaml"
            path.write_text(
                "calibration: c.npz\nsource: {kind: simulated}\n"
                f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            )
            with (
                TrialBroker(load(path)) as named,
                pytest.raises(DeviceError, match=rf"^127.0.0.1:{broker.port}: ") as raised,
            ):
                try_daemon(wanted(1), named, 1.0)
            assert "\n" not in str(raised.value)


def test_without_any_broker_it_says_which_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child.shutil, "which", lambda *_args, **_more: None)
    monkeypatch.setattr(child.importlib.util, "find_spec", lambda _name: None)
    with pytest.raises(DeviceError, match="found no broker, expected mosquitto"):
        TrialBroker(None)
