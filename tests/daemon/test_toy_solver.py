"""A new solver is one file and one line: from the settings through the daemon to an MQTT subscriber."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.toy_solver import CELLS, DEPTH_MM, ToySolver

from tacshade_edge.core.depth import SOLVERS
from tacshade_edge.core.geometry import disc_map
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.app import App
from tacshade_edge.protocol import wire
from tacshade_edge.settings import load
from tacshade_edge.types import U8, Calibration
from tools.testbed.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tools.testbed.painted_sensor import DISC
from tools.testbed.patience import patience, wait_until

pytestmark = [pytest.mark.broker, pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")]


def frames(image: U8, stop: threading.Event) -> Iterator[Any]:
    """50 in a second."""
    while not stop.is_set():
        yield image
        yield lambda: stop.wait(0.02)
    yield None


def test_from_settings_to_a_decoded_height(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    monkeypatch.setitem(SOLVERS, "toy", ToySolver)
    monkeypatch.setitem(PROFILES, "toy", replace(PROFILES["accurate"], name="toy", solver="toy", network=None))
    stop = threading.Event()
    with Broker(tmp_path) as broker, Subscriber(broker.port) as seen:
        settings = tmp_path / "settings.yaml"
        settings.write_text(
            f"sensor_id: toy\nsource: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            "recorder: {folder: recs}\nprofile: toy\n",
            encoding="utf-8",
        )
        app = App(load(settings), scripted(frames(pictures.touched, stop)), calibration)
        thread = threading.Thread(target=app.run)
        thread.start()
        try:
            wait_until(lambda: bool(seen.of("tacshade/toy/height")), 10, "a height")
            wait_until(lambda: "depth" in last_stages(seen), 10, "its stages")
        finally:
            stop.set()
            app.stop()
            thread.join(patience(20))
        assert not thread.is_alive()
        height = wire.decode(seen.of("tacshade/toy/height")[0])
        info = json.loads(seen.of("tacshade/toy/info")[-1])
        stages = last_stages(seen)
    assert isinstance(height, wire.HeightMessage)
    grid = disc_map.map_grid(DISC, CELLS)
    assert height.height_mm.shape == (CELLS, CELLS)
    assert (height.row0, height.col0, height.step_px) == pytest.approx((grid.row0, grid.col0, grid.step_px))
    assert (height.contact, height.invalid) == (True, False)
    assert np.unique(height.height_mm[np.isfinite(height.height_mm)]).tolist() == pytest.approx([0.0, DEPTH_MM])
    assert np.isnan(height.height_mm[0, 0])
    assert info["profile"] == "toy"
    assert "toy" in info["profiles"]
    assert {"check", "grey", "gate", "depth", "cloud"} <= set(stages)
    assert "denoise" not in stages


def last_stages(seen: Subscriber) -> dict[str, Any]:
    """Of the latest ``health``."""
    payloads = seen.of("tacshade/toy/health")
    return dict(json.loads(payloads[-1])["stages_ms"]) if payloads else {}
