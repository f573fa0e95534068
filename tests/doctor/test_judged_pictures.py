"""Pictures that another program has mirrored or turned are recognised as such."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.calibrated_sensor import calibrated, unloaded
from tacshade_edge.doctor.judged_pictures import judge_pictures
from tacshade_edge.types import U8

WAYS: dict[str, Callable[[U8], U8]] = {
    "mirrored left to right": np.fliplr,
    "mirrored top to bottom": np.flipud,
    "turned by 180 degrees": lambda image: np.rot90(image, 2),
    "turned by 90 degrees": np.rot90,
    "with rows and columns swapped": lambda image: image.swapaxes(0, 1),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_turned_picture_says_how_it_would_pass(tmp_path: Path, way: str) -> None:
    image = unloaded()
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), image)
    (good,) = judge_pictures(calibrated(), "fast", [path])
    assert good.reason is None
    cv2.imwrite(str(path), np.ascontiguousarray(WAYS[way](image)))
    (turned,) = judge_pictures(calibrated(), "fast", [path])
    assert turned.reason is not None
    assert f"; it passes {way}" in turned.reason.text


def test_a_picture_of_something_else_is_no_turned_one(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.full_like(unloaded(), 90))
    (other,) = judge_pictures(calibrated(), "fast", [path])
    assert other.reason is not None
    assert "it passes" not in other.reason.text
