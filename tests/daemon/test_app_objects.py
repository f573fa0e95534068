"""What `teach` writes while the daemon runs is published as the object's name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from support.running_app import Live, paced
from tacshade_edge.calibration.files import objects_file
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.sensor.recognition.naming import describe_touch
from tacshade_edge.types import Calibration, Frame

pytestmark = [pytest.mark.broker, pytest.mark.slow]


def test_an_object_taught_while_the_daemon_runs_is_named(
    live: Live, pictures: Any, scripted: Any, calibration: Calibration, tmp_path: Path
) -> None:
    known: objects_file.Known = {}
    for profile in LADDER:
        made = make_reconstructor(calibration, PROFILES[profile])
        seen = made.step(Frame(0, 0, 0, pictures.touched)).height
        description = describe_touch(seen, made.rays, calibration.geometry)
        assert description is not None
        known = objects_file.taught(known, profile, "nut_m8", description[None])
    with live.run(scripted(paced(pictures.touched))):
        live.until_state("online")
        assert live.payloads("event/object") == []
        objects_file.save(objects_file.path_beside(tmp_path / "calibration.npz"), known)
        event = live.until("event/object", "the name", 20, name="nut_m8", label=1)
    assert 0 < event["probability"] <= 1
