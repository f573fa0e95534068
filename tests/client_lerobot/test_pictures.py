"""Height and shear as colours and back, and a sensor's messages put together to pictures; without LeRobot."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from support.published_sensor import CRC, bump, calibration, dragged
from tacshade_client import Message, decode_message

from tacshade_edge.protocol import messages, wire
from tacshade_edge.reasons import Reason, ReasonCode

FOLDER = Path(__file__).parents[2] / "client_lerobot/lerobot_camera_tacshade"
HALF_STEP_MM = 0.0125 + 1e-6


def room() -> ModuleType:
    """The package without its first line, which asks for LeRobot."""
    if (made := sys.modules.get("lerobot_camera_tacshade")) is None:
        made = sys.modules["lerobot_camera_tacshade"] = ModuleType("lerobot_camera_tacshade")
        made.__path__ = [str(FOLDER)]
    return made


@pytest.fixture(autouse=True)
def _room() -> Iterator[None]:
    room()
    return


room()
colours = import_module("lerobot_camera_tacshade.colours")
pictures = import_module("lerobot_camera_tacshade.pictures")


@given(
    npst.arrays(np.float32, (4, 5), elements=st.floats(0, np.float32(6.35), width=32) | st.just(np.nan)),
    npst.arrays(np.float32, (4, 5, 2), elements=st.floats(-3.171875, 3.171875, width=32)),
)
def test_millimetres_come_back_to_half_a_grey_level(height_mm: Any, shear_mm: Any) -> None:
    picture = colours.to_rgb(height_mm, shear_mm)
    height, shear = colours.to_mm(picture)
    outside = np.isnan(height_mm)
    np.testing.assert_array_equal(np.isnan(height), outside)
    np.testing.assert_array_equal(picture[outside], 0)
    assert np.all(np.abs(height - height_mm)[~outside] <= HALF_STEP_MM)
    assert np.all(np.abs(shear - shear_mm)[~outside] <= HALF_STEP_MM)
    np.testing.assert_array_equal(colours.to_rgb(height, shear), picture)


@given(
    npst.arrays(np.float32, (3, 3), elements=st.floats(width=32)),
    npst.arrays(np.float32, (3, 3, 2), elements=st.floats(width=32)),
)
def test_extremes_are_clipped_and_never_wrapped(height_mm: Any, shear_mm: Any) -> None:
    with np.errstate(over="ignore"):
        picture = colours.to_rgb(height_mm, shear_mm)
    inside = ~np.isnan(height_mm)
    assert picture[inside].min(initial=255) >= 1
    assert (picture[inside & (height_mm > 6.4)][:, 0] == 255).all()
    assert (picture[inside & (height_mm < 0)][:, 0] == 1).all()
    assert (picture[inside & (shear_mm[..., 0] < -3.2)][:, 1] == 1).all()


def message(part: str, payload: bytes) -> Message:
    return decode_message(f"tacshade/left/{part}", payload)


INFO = message("info", messages.encode_info(version="1", config_digest="", profile="fast", calibration=calibration()))


def frame(seq: int, depth_mm: float, step_px: int = 4, crc: int = CRC) -> list[Message]:
    pressed = dragged(bump(seq, depth_mm, 236.0, 328.0, step_px=step_px), 0.5, -0.25)
    contact = message("contact", messages.encode_contact(pressed, fps=60.0))
    if not depth_mm:
        return [contact]
    height, shear = (e(pressed, calibration_crc32=crc) for e in (wire.encode_height, wire.encode_shear))
    return [message("height", height), message("shear", shear), contact]


@pytest.mark.parametrize("step_px", [1, 4])
def test_a_press_is_where_and_as_deep_as_it_was_on_any_grid(step_px: int) -> None:
    made = pictures.Pictures(112)
    assert made.add(INFO) is None
    found = [made.add(each) for each in frame(7, 2.0, step_px)]
    assert found[:2] == [None, None]
    height_mm, shear_mm = colours.to_mm(found[2])
    assert height_mm.shape == (112, 112)
    row, col = np.unravel_index(np.nanargmax(height_mm), height_mm.shape)
    assert max(abs(row - 55.5), abs(col - 55.5)) <= 2
    assert height_mm[row, col] == pytest.approx(2.0, abs=0.02)
    assert shear_mm[row, col] == pytest.approx((0.5, -0.25), abs=0.02)
    assert np.isnan(height_mm[0, 0])
    assert made.passed_over == 0


def test_an_untouched_skin_is_flat() -> None:
    made = pictures.Pictures(56)
    made.add(INFO)
    (picture,) = (made.add(each) for each in frame(1, 0.0))
    inside = picture[..., 0] > 0
    assert 0.7 < inside.mean() < 0.8
    np.testing.assert_array_equal(np.unique(picture[inside], axis=0), [[1, 128, 128]])


def test_what_is_not_of_the_frame_gives_no_picture() -> None:
    made = pictures.Pictures(56)
    height, shear, contact = frame(3, 2.0)
    assert made.add(contact) is None  # no geometry yet
    made.add(INFO)
    assert made.add(contact) is None  # no height yet
    for each in (*frame(2, 2.0)[:2], contact):
        assert made.add(each) is None
    for each in frame(4, 2.0, crc=1):
        assert made.add(each) is None  # of another calibration
    assert made.passed_over == 4
    assert [made.add(each) is None for each in (height, shear, contact)] == [True, True, False]
    torn = bump(9, 0.0, 0.0, 0.0)
    invalid = messages.encode_contact(type(torn)(**{**fields(torn), "valid": False, "reason": TORN}), fps=1.0)
    assert made.add(message("contact", invalid)) is None


TORN = Reason(ReasonCode.TORN, "torn")


def fields(result: Any) -> dict[str, Any]:
    return {name: getattr(result, name) for name in result.__slots__}
