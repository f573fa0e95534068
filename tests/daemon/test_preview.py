"""The daemon's preview of pictures of extreme sizes, before there is a calibration."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest

from support.patience import wait_until
from support.running_app import Live, paced
from tacshade_edge.reasons import Reason, ReasonCode

pytestmark = [pytest.mark.broker, pytest.mark.slow]


@pytest.mark.parametrize(
    ("width_px", "height_px"),
    [(1, 1000), (1000, 1), (3, 8000), (8000, 3), (8192, 511), (16, 16), (1, 1), (8000, 6000)],
)
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_picture_of_any_size_ends_no_daemon(
    live: Live,
    pictures: Any,
    scripted: Any,
    caplog: pytest.LogCaptureFixture,
    width_px: int,
    height_px: int,
    channels: tuple[int, ...],
) -> None:
    odd, has_ended = np.full((height_px, width_px, *channels), 99, np.uint8), threading.Event()

    def frames() -> Iterator[Any]:
        while True:
            yield from paced(pictures.free if has_ended.is_set() else odd, 1)

    def shown() -> list[tuple[int, ...]]:
        jpegs = live.payloads("preview")
        return [cv2.imdecode(np.frombuffer(each, np.uint8), 0).shape for each in jpegs]

    reason = f"no preview of {width_px}x{height_px} px, expected no side over 16 times as long"
    with live.run(scripted(frames()), "", Reason(ReasonCode.NOT_CALIBRATED, "none")) as running:
        if max(odd.shape[:2]) > 16 * min(odd.shape[:2]):
            wait_until(lambda: reason in caplog.text, 15, "the reason is named")
            assert live.payloads("preview") == []
        else:
            expected = (320, 320) if width_px == height_px else (240, 320)
            wait_until(lambda: expected in shown(), 15, "a preview")
        has_ended.set()
        wait_until(lambda: shown()[-1:] == [(240, 320)], 15, "a preview of the next picture")
        wait_until(lambda: running.counts().captured > 3, 15, "it runs")
    assert running.error is None
    assert caplog.text.count(reason) <= 1
