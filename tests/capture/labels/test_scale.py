"""A scale that a pty plays."""

from __future__ import annotations

import os
import tty
from collections.abc import Iterator

import numpy as np
import pytest

from tacshade_edge.capture.labels.scale import Scale, force_at, scale_port
from tacshade_edge.errors import DeviceError
from tools.testbed.patience import patience, wait_until


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


def test_readings_one_byte_at_a_time(line: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
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
        monkeypatch.setattr("tacshade_edge.capture.labels.scale.READINGS_MAX", 4)
        with pytest.raises(DeviceError, match="reached the limit of 4 readings per run"):
            scale.check()
    finally:
        scale.close()


def test_force_between_readings() -> None:
    t_s, force_n = np.array((10.0, 10.5, 12.0)), np.array((1.0, 2.0, 3.0))
    assert force_at(10.25, t_s, force_n) == pytest.approx(1.5)
    assert [force_at(at_s, t_s, force_n) for at_s in (9.9, 11.0, 12.1)] == [None, None, None]
    assert force_at(10.25, t_s[:0], force_n[:0]) is None


def test_a_scale_that_says_nothing_of_use(line: tuple[int, str], monkeypatch: pytest.MonkeyPatch) -> None:
    master, name = line
    monkeypatch.setattr("tacshade_edge.capture.labels.scale._SILENT_S", 0.0)
    scale = Scale(scale_port(f"{name}:4800"))
    scale.open()
    try:
        with pytest.raises(
            DeviceError, match=r"found nothing in the last 0 s, expected lines with a number and a unit \(g"
        ):
            scale.check()
        os.write(master, b"12.5\n")
        wait_until(lambda: scale._unread, 10, "the line")
        with pytest.raises(DeviceError, match=r"found '12\.5' in the last 0 s, .*; does the scale send at 4800 baud"):
            scale.check()
    finally:
        scale.close()


def test_a_scale_that_is_unplugged() -> None:
    master, slave = os.openpty()
    scale = Scale(scale_port(os.ttyname(slave)))
    os.close(slave)
    scale.open()
    os.close(master)

    scale._thread.join(patience(10))
    with pytest.raises(DeviceError, match="unplugged"):
        scale.check()
    scale.close()


def test_a_port_that_is_not_there() -> None:
    scale = Scale(scale_port("/dev/nothing-here"))
    with pytest.raises(DeviceError, match="serial /dev/nothing-here: no such device"):
        scale.open()
    scale.close()
