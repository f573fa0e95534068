"""A daemon whose camera mirrors its pictures says so."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import calibrated, step, unloaded
from support.running_app import Live, paced
from tacshade_edge.mqtt.publishing import HealthReport
from tacshade_edge.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.types import Frame


@pytest.mark.parametrize(
    ("way", "code"),
    [("mirrored left to right", "surround"), ("mirrored top to bottom", "camera_shift")],
)
def test_a_camera_that_mirrors_its_pictures_is_recognised(
    live: Live, scripted: Any, way: str, code: str
) -> None:
    image, mirrored = unloaded(), threading.Event()
    turned = np.ascontiguousarray(np.fliplr(image) if "left" in way else np.flipud(image))

    def script() -> Iterator[Any]:
        while True:
            yield from paced(turned if mirrored.is_set() else image, 1)

    with live.run(scripted(script()), calibration=calibrated()):
        live.until_state("online")
        mirrored.set()
        live.until_state("degraded")
        camera = live.last("status/camera")
        assert (camera["state"], camera["reason_code"]) == ("unusable", code)
        assert camera["reason"].endswith(
            f"; it passes {way}: has the camera or a program done that?"
        )
        mirrored.clear()
        live.until_state("online")


def test_pictures_that_are_used_although_they_are_mirrored_are_warned_of_once(
    caplog: pytest.LogCaptureFixture,
) -> None:
    known, image = calibrated(), unloaded()
    valid = step("fast", image)
    health = HealthReport(FrameLedger(), Timings())
    for turned, count in ((image, 0), (np.ascontiguousarray(np.fliplr(image)), 1)):
        # Another calibration, of which nothing is known yet.
        own = replace(known, crc32=count)
        for seq in range(3):
            health.see(FrameResult(Frame(seq, 0, 0, turned), own, valid))
            health.snapshot(0, {})
        said = [record.message for record in caplog.records]
        assert len(said) == count
    assert said == [
        "pictures fit the reference only mirrored left to right: has the camera or a program done "
        "that?"
    ]
