"""A daemon whose camera mirrors its pictures says so."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from support.calibrated_sensor import calibrated, unloaded
from support.running_app import Live, paced


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
