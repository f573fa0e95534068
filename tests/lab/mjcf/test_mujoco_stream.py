"""A sensor in MuJoCo on a real broker: its messages are a daemon's."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tacshade_client import decode_message

import tacshade_edge as ts
from support.calibrated_sensor import HALF
from support.felt_objects import written
from support.mqtt_rig import Broker, Subscriber, free_port

mujoco: Any = pytest.importorskip("mujoco")
pytestmark = pytest.mark.broker

BASE = "tacshade/left-index"


class Ball:
    """The scene's ball, which begins a millimetre above the skin, and the sensor."""

    def __init__(self, folder: Path) -> None:
        written(folder, HALF)
        self._model = mujoco.MjModel.from_xml_path(str(folder / "scene.xml"))
        self._data = mujoco.MjData(self._model)
        mujoco.mj_forward(self._model, self._data)
        self.sensor = ts.MujocoSensor(self._model, self._data)

    def press(self, depth_mm: float) -> None:
        self._data.qpos[0] = (depth_mm + 1) / 1e3
        self._data.time += 0.01
        mujoco.mj_forward(self._model, self._data)


@pytest.fixture
def ball(tmp_path: Path) -> Ball:
    return Ball(tmp_path)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path) as broker:
        yield broker


def test_a_listener_gets_the_results_of_a_real_sensor(ball: Ball, broker: Broker) -> None:
    address = f"127.0.0.1:{broker.port}"
    with (
        ts.MujocoStream(ball.sensor, address, "left-index") as stream,
        ts.listen(address, "left-index") as results,
    ):
        ball.press(2.0)
        sent = stream.send()
        heard = next(results)
        assert (heard.seq, heard.t_ns, heard.in_contact) == (sent.seq, 10_000_000, True)
        assert heard.depth_max_mm == pytest.approx(sent.depth_max_mm, abs=2e-3)
        assert np.allclose(heard.height_mm, sent.height_mm, atol=1e-3, equal_nan=True)
        assert np.array_equal(heard.contact, sent.contact)
        assert heard.shear_mm is not None
        assert heard.touch is not None
        assert heard.touch["depth_mm"] == pytest.approx(2.0, abs=0.1)
        assert heard.pose == sent.pose
        ball.press(-0.5)
        stream.send()
        assert not next(results).in_contact
    assert next(results, None) is None


def test_the_thin_client_decodes_every_message(ball: Ball, broker: Broker) -> None:
    topics = ("info", "height", "cloud", "shear", "contact", "touch", "event/contact")
    with Subscriber(broker.port, f"{BASE}/#") as heard:
        with ts.MujocoStream(ball.sensor, f"127.0.0.1:{broker.port}", "left-index") as stream:
            ball.press(1.5)
            stream.send()
            values: dict[str, Any] = {
                topic: decode_message(f"{BASE}/{topic}", heard.wait_for(f"{BASE}/{topic}")[0]).value
                for topic in topics
            }
        heard.wait_for_last(f"{BASE}/state", b"stopped")
    known = values["info"].geometry
    assert known.geometry.disc == HALF.geometry.disc
    assert values["height"].calibration_crc32 == known.calibration_crc32
    assert float(np.nanmax(values["height"].height_mm)) == pytest.approx(1.5, abs=0.1)
    assert values["contact"].contact == 1


def test_requests_are_refused_with_a_reason(ball: Ball, broker: Broker) -> None:
    with (
        Subscriber(broker.port, f"{BASE}/#") as heard,
        ts.MujocoStream(ball.sensor, f"127.0.0.1:{broker.port}", "left-index"),
    ):
        heard.publish(f"{BASE}/req/reference", b"{}")
        (answer,) = heard.wait_for(f"{BASE}/res/reference")
    assert b"MuJoCo does not accept this request" in answer


def test_an_absent_broker_is_reported(ball: Ball) -> None:
    with pytest.raises(ts.DeviceError, match="Connection refused"):
        ts.MujocoStream(ball.sensor, f"127.0.0.1:{free_port()}", "left-index")
