"""The study that makes each free frame of a real set the reference in turn."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import pytest

from support.calibrated_sensor import HALF, calibrated, simulated
from tools.studies.real_references import halves, span
from tools.studies.real_sets import RealFrame


def test_a_span_leaves_out_what_is_unknown() -> None:
    assert span([0.2, math.nan, 0.1, 0.9], 1) == "0.1, 0.2, 0.9"
    assert span([0, 3, 1], 0, of=32) == "0, 1, 3 of 32"


def free_frames(folder: Path, count: int) -> list[RealFrame]:
    paths = [folder / f"{k}.png" for k in range(count)]
    for k, path in enumerate(paths):
        cv2.imwrite(str(path), simulated(HALF).frame((), 50 + k).image)
    return [RealFrame(path, True, {}) for path in paths]


@pytest.mark.slow
def test_each_half_is_judged_by_the_limits_of_the_other(tmp_path: Path) -> None:
    frames = free_frames(tmp_path, 17)
    (first, judged_first), (second, judged_second) = halves(calibrated(), frames)
    assert [*judged_first, *judged_second] == [*frames[1::2], *frames[::2]]
    assert first.rest["fast"].frames == 9
    assert second.rest["fast"].frames == 8


@pytest.mark.slow
def test_too_few_free_frames_are_judged_without_limits(tmp_path: Path) -> None:
    frames = free_frames(tmp_path, 5)
    assert halves(calibrated(), frames) == [(calibrated(), frames)]
