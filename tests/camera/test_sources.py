"""The size that is requested of a camera."""

from __future__ import annotations

import pytest

from tacshade_edge.camera.source_settings import DEFAULT_SIZE_PX
from tacshade_edge.camera.sources import best_size
from tacshade_edge.settings import Files, Rpicam, Source, V4l2


@pytest.mark.parametrize(
    ("source", "calibration_px", "expected_px"),
    [
        (V4l2(), None, DEFAULT_SIZE_PX),
        (Rpicam(), None, DEFAULT_SIZE_PX),
        (V4l2(), (800, 600), (800, 600)),
        (V4l2(width_px=640, height_px=480), (800, 600), (640, 480)),
        (V4l2(width_px=640, height_px=480), None, (640, 480)),
    ],
)
def test_settings_then_calibration_then_the_default_state_the_size(
    source: Source, calibration_px: tuple[int, int] | None, expected_px: tuple[int, int]
) -> None:
    found = source.sized(calibration_px)
    assert isinstance(found, V4l2 | Rpicam)
    assert (found.width_px, found.height_px) == expected_px


def test_other_sources_have_no_size() -> None:
    source = Files(path="a")
    assert source.sized((800, 600)) is source


@pytest.mark.parametrize(
    ("offered", "best"),
    [
        ([], (320, 240)),
        ([(160, 120), (320, 240), (640, 480)], (320, 240)),
        ([(1280, 720), (640, 480), (800, 600)], (640, 480)),
        ([(320, 180), (640, 360), (640, 480), (1280, 720)], (640, 480)),
        ([(320, 180), (1280, 720), (640, 360)], (640, 360)),
        ([(160, 120)], (320, 240)),
    ],
)
def test_a_camera_gives_the_least_size_that_holds_the_default(
    offered: list[tuple[int, int]], best: tuple[int, int]
) -> None:
    assert best_size(offered) == best
