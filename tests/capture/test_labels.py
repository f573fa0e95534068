"""Labels of a scale that a pty plays and of a robot: their clocks, signs and order of rotations."""

from __future__ import annotations

import math
import os
import re
import tty
from collections.abc import Iterator

import numpy as np
import pytest

from support.patience import wait_until
from tacshade_edge.capture.robot_place import labels_between
from tacshade_edge.capture.scale import (
    ERROR_MOST_S,
    PRESSES_LEAST,
    Scale,
    ScalePress,
    find_offset,
    force_at,
    scale_port,
)
from tacshade_edge.errors import DeviceError
from tacshade_edge.rigid import Rigid, shift, turn
from tacshade_edge.types import F64


def pressed(t_s: F64, at_s: float) -> F64:
    """A press of 2 s: down in 0.3 s, held, lifted in 0.2 s."""
    shape: F64 = np.interp(t_s - at_s, (0, 0.3, 1.2, 1.8, 2.0), (0.0, 1.0, 0.8, 0.9, 0.0))
    return shape


def taken(
    count: int, seed: int, late_s: float, scatter_s: float = 0.0
) -> tuple[list[ScalePress], F64, F64]:
    """Pictures at 30/s whose change is no straight line of force;
    a scale at 10/s, rounded to 10 mN.
    """
    rng = np.random.default_rng(seed)
    presses = []
    scale_s = np.arange(0, 5.0 * count + 2, 0.1) + rng.uniform(0, 0.01)
    force_n = np.zeros(len(scale_s))
    for k in range(count):
        at_s = 5.0 * k + 1
        t_s = at_s - 0.7 + np.arange(105) / 30
        presses.append(
            ScalePress(t_s, 4 * pressed(t_s, at_s) ** 0.7 + rng.normal(0, 0.1, len(t_s)))
        )
        force_n += 2 * pressed(scale_s - late_s - scatter_s * (-1) ** k, at_s)
    return presses, scale_s, np.round(force_n + rng.normal(0, 0.01, len(force_n)), 2)


@pytest.mark.parametrize("late_s", [-0.2, 0.0, 0.35, 0.75])
def test_a_delay_is_found_and_its_error_holds(late_s: float) -> None:
    off = []
    for seed in range(8):
        found = find_offset(*taken(6, seed, late_s))
        assert found.presses == 6
        assert found.error_s < 0.02
        off.append((found.offset_s - late_s) / max(found.error_s, 0.004))
    assert np.abs(off).max() < 5
    assert np.abs(np.median(off)) < 3


def test_too_few_presses_and_a_scale_that_sees_other_things_are_refused() -> None:
    presses, t_s, force_n = taken(6, 1, 0.1)
    with pytest.raises(
        ValueError, match=rf"found 2 presses \(of 2\) .*, expected at least {PRESSES_LEAST}"
    ):
        find_offset(presses[:2], t_s, force_n)
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s, np.zeros_like(force_n))
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s, np.random.default_rng(2).normal(0, 1, len(t_s)))
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s + 2.5, force_n)  # beyond the range
    with pytest.raises(ValueError, match="found 0 presses"):
        find_offset(presses, t_s[:2], force_n[:2])


def test_presses_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(
        ValueError, match=f"expected a standard error of at most {1e3 * ERROR_MOST_S:.0f} ms"
    ):
        find_offset(*taken(4, 3, 0.3, scatter_s=0.25))


R_MM = 20.0
TIP = shift(0, 0, R_MM)
FIRST = shift(300, -20, 150) @ turn((2.0, 0.3, 0.1))


def labels(now_T_object: Rigid) -> dict[str, float]:
    """Of an object whose own frame was at the tip at first touch, and is there now."""
    return labels_between(FIRST, FIRST @ TIP @ now_T_object.inverse(), R_MM)


def expected(**values: float) -> dict[str, float]:
    names = ("depth_mm", "tilt_x_deg", "tilt_y_deg", "shear_x_mm", "shear_y_mm", "twist_deg")
    return {name: pytest.approx(values.get(name, 0.0), abs=1e-9) for name in names}


def test_a_sensor_that_goes_down_and_aside_drags_the_object_the_other_way() -> None:
    assert labels_between(FIRST, FIRST, R_MM) == expected()
    assert labels_between(FIRST, FIRST @ shift(0.5, -0.25, 1.5), R_MM) == expected(
        depth_mm=1.5, shear_x_mm=-0.5, shear_y_mm=0.25
    )


def test_twist_then_tilt_about_x_then_about_y() -> None:
    a, b, c = (math.radians(angle) for angle in (12.0, -7.0, 25.0))
    now = shift(0.4, -0.3, R_MM - 1.25) @ turn((0, b, 0)) @ turn((a, 0, 0)) @ turn((0, 0, c))
    assert labels(now) == expected(
        depth_mm=1.25, tilt_x_deg=12, tilt_y_deg=-7, shear_x_mm=0.4, shear_y_mm=-0.3, twist_deg=25
    )
    x, y, z = now.rotation @ np.array(
        (0.0, 0.0, 1.0)
    )  # as `sensor.touch.touch_answer` has them of a contact's normal
    assert (-math.degrees(math.asin(y)), math.degrees(math.atan2(x, z))) == pytest.approx((12, -7))


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """The scale's end of a pty, and the name of ours."""
    master, slave = os.openpty()
    tty.setraw(slave)
    yield master, os.ttyname(slave)
    os.close(slave)
    os.close(master)


@pytest.mark.parametrize(
    ("text", "device", "baud"),
    [
        ("/dev/ttyUSB0", "/dev/ttyUSB0", 9600),
        ("/dev/ttyUSB0:115200", "/dev/ttyUSB0", 115200),
        (
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0-port0",
            9600,
        ),
        ("socket://scale:4001", "socket://scale:4001", 9600),
    ],
)
def test_the_port_of_the_option(text: str, device: str, baud: int) -> None:
    port = scale_port(text)
    assert (port.device, port.baud) == (device, baud)


def test_readings_one_byte_at_a_time(line: tuple[int, str]) -> None:
    master, name = line
    scale = Scale(scale_port(name))
    scale.open()
    try:
        for byte in b"23 g\r\nST,+0.5 N\r\nOL\r\n-1.5 N\r0.25 N\n":
            os.write(master, bytes([byte]))
        wait_until(lambda: len(scale.readings()[0]) == 4, 10, "four readings")
        t_s, force_n = scale.readings()
        assert force_n.tolist() == pytest.approx([0.023 * 9.80665, 0.5, -1.5, 0.25])
        assert (np.diff(t_s) >= 0).all()
        assert scale.median_n(0)[0] == pytest.approx(0.237776, abs=1e-6)
        assert np.isnan(scale.median_n(t_s[-1] + 1)).all()
        scale.check()
    finally:
        scale.close()


def test_force_between_readings() -> None:
    t_s, force_n = np.array((10.0, 10.5, 12.0)), np.array((1.0, 2.0, 3.0))
    assert force_at(10.25, t_s, force_n) == pytest.approx(1.5)
    assert [force_at(at_s, t_s, force_n) for at_s in (9.9, 11.0, 12.1)] == [None, None, None]
    assert force_at(10.25, t_s[:0], force_n[:0]) is None


def refusal(scale: Scale) -> str:
    """Why the scale cannot be used; empty if it can."""
    try:
        scale.check()
    except DeviceError as error:
        return str(error)
    return ""


def test_a_scale_that_says_nothing_of_use(
    line: tuple[int, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    master, name = line
    monkeypatch.setattr("tacshade_edge.capture.scale._SILENT_S", 0.0)
    scale = Scale(scale_port(f"{name}:4800"))
    scale.open()
    try:
        with pytest.raises(
            DeviceError,
            match=r"found nothing in the last 0 s, expected lines with a number and a unit \(g",
        ):
            scale.check()
        os.write(master, b"12.5\n")
        expected = r"found '12\.5' in the last 0 s, .*; does the scale send at 4800 baud"
        wait_until(lambda: bool(re.search(expected, refusal(scale))), 10, "the line")
    finally:
        scale.close()


def test_a_scale_that_is_unplugged() -> None:
    master, slave = os.openpty()
    scale = Scale(scale_port(os.ttyname(slave)))
    os.close(slave)
    scale.open()
    os.close(master)

    wait_until(lambda: "unplugged" in refusal(scale), 10, "the reader's error")
    scale.close()
