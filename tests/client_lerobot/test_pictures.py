"""Height and shear as colours and back, a sensor's messages put together to pictures,
and mistakes in settings.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from tacshade_client import Message, decode_message

from support.hostile_broker import BAD, HostileBroker
from support.mqtt_rig import free_port
from support.published_sensor import CRC, bump, calibration, dragged, unmeasured
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire import binary, messages

FOLDER = Path(__file__).parents[2] / "client_lerobot/lerobot_camera_tacshade"
HALF_STEP_MM = 0.0125 + 1e-6


def lerobot() -> None:
    """What the plugin imports of LeRobot, if that is absent."""
    if "lerobot" in sys.modules or find_spec("lerobot") is not None:
        return
    for name in (
        "lerobot",
        "cameras",
        "cameras.camera",
        "cameras.configs",
        "utils",
        "utils.errors",
    ):
        full = "lerobot" if name == "lerobot" else f"lerobot.{name}"
        sys.modules[full] = ModuleType(full)
    config = type(
        "CameraConfig", (), {"register_subclass": staticmethod(lambda _: lambda cls: cls)}
    )
    camera = type(
        "Camera", (), {"__init__": lambda self, config: setattr(self, "width", config.width)}
    )
    sys.modules["lerobot.cameras.configs"].CameraConfig = config  # type: ignore[attr-defined]
    sys.modules["lerobot.cameras.camera"].Camera = camera  # type: ignore[attr-defined]
    for name in ("DeviceAlreadyConnectedError", "DeviceNotConnectedError"):
        setattr(sys.modules["lerobot.utils.errors"], name, type(name, (ConnectionError,), {}))


def room() -> ModuleType:
    """The package without its first line, which asks for all of LeRobot."""
    if (made := sys.modules.get("lerobot_camera_tacshade")) is None:
        made = sys.modules["lerobot_camera_tacshade"] = ModuleType("lerobot_camera_tacshade")
        made.__path__ = [str(FOLDER)]
    return made


@pytest.fixture(autouse=True)
def _room() -> Iterator[None]:
    room()
    return


room()
lerobot()
camera = import_module("lerobot_camera_tacshade.camera")
config = import_module("lerobot_camera_tacshade.config")
colours = import_module("lerobot_camera_tacshade.colours")
pictures = import_module("lerobot_camera_tacshade.pictures")


@given(
    npst.arrays(
        np.float32, (4, 5), elements=st.floats(0, np.float32(6.35), width=32) | st.just(np.nan)
    ),
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
    height_mm[0, :3], shear_mm[0] = (1e30, -5.0, 1.0), -1e30  # clipped, never wrapped
    picture = colours.to_rgb(height_mm, shear_mm)
    assert (picture[0, :3, 0].tolist(), picture[0, :3, 1:].max()) == ([255, 1, 41], 1)


def message(part: str, payload: bytes) -> Message:
    return decode_message(f"tacshade/left/{part}", payload)


INFO = message(
    "info",
    messages.encode_info(version="1", config_digest="", profile="fast", calibration=calibration()),
)


def frame(seq: int, depth_mm: float, step_px: int = 4, crc: int = CRC) -> list[Message]:
    pressed = dragged(bump(seq, depth_mm, 236.0, 328.0, step_px=step_px), 0.5, -0.25)
    contact = message("contact", messages.encode_contact(pressed, fps=60.0))
    if not depth_mm:
        return [contact]
    height, shear = (
        e(pressed, calibration_crc32=crc) for e in (binary.encode_height, binary.encode_shear)
    )
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
    assert np.nanmax(np.abs(made.height_mm - height_mm)) <= HALF_STEP_MM
    known = dict(zip(pictures.TACTILE, made.tactile.tolist(), strict=True))
    assert (known["contact"], known["depth_max_mm"], known["shear_x_mm"], known["slip"]) == (
        1,
        2.0,
        0.5,
        0,
    )
    assert pictures.tactile_feature()["shape"] == made.tactile.shape
    assert made.passed_over == 0


def test_an_untouched_skin_is_flat() -> None:
    made = pictures.Pictures(56)
    made.add(INFO)
    (picture,) = (made.add(each) for each in frame(1, 0.0))
    inside = picture[..., 0] > 0
    assert 0.7 < inside.mean() < 0.8
    np.testing.assert_array_equal(np.unique(picture[inside], axis=0), [[1, 128, 128]])


def test_a_touch_of_unknown_depth_is_flat_but_a_contact() -> None:
    made = pictures.Pictures(56)
    made.add(INFO)
    untouched = made.add(*frame(1, 0.0))
    assert made.tactile[0] == 0
    lost = messages.encode_contact(unmeasured(2), fps=60.0)
    np.testing.assert_array_equal(made.add(message("contact", lost)), untouched)
    known = dict(zip(pictures.TACTILE, made.tactile.tolist(), strict=True))
    assert known.pop("contact") == 1
    assert np.isnan(list(known.values())).all()
    assert made.passed_over == 0


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
    for each in (height, frame(3, 2.0, step_px=8)[1], contact):
        assert made.add(each) is None  # the shear has another grid
    assert made.passed_over == 5
    assert [made.add(each) is None for each in (height, shear, contact)] == [True, True, False]
    torn = replace(bump(9, 0.0, 0.0, 0.0), valid=False, reason=Reason(ReasonCode.TORN, "torn"))
    assert made.add(message("contact", messages.encode_contact(torn, fps=1.0))) is None


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"broker": "mqtt://h"}, "broker: found 'mqtt://h', expected HOST or HOST:PORT"),
        ({"sensor": "a/b"}, "name: found 'a/b', expected a sensor"),
        ({"password_file": "absent"}, "No such file or directory: 'absent'"),
        ({"password_file": sys.executable}, "can't decode byte"),
        ({"ca_file": "absent"}, "absent: No such file or directory; expected a PEM file"),
        ({}, "Connection refused; expected a broker"),
    ],
)
def test_a_mistake_in_the_settings_is_a_connection_error_of_one_line(
    settings: dict[str, str], says: str
) -> None:
    made = camera.TacShadeCamera(
        config.TacShadeCameraConfig(
            **{"sensor": "left", "broker": f"localhost:{free_port()}", **settings}
        )
    )
    with pytest.raises(ConnectionError) as caught:
        made.connect()
    assert str(caught.value).startswith("TacShadeCamera(")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not made.is_connected


def test_a_sensor_that_is_not_there_is_a_connection_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera, "_CONNECT_S", 0.1)
    with HostileBroker(BAD) as broker:
        made = camera.TacShadeCamera(
            config.TacShadeCameraConfig(sensor="left", broker=f"localhost:{broker.port}")
        )
        with pytest.raises(
            ConnectionError, match="no picture within 100 ms; expected a calibrated sensor"
        ):
            made.connect()
    assert not made.is_connected
