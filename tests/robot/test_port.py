from __future__ import annotations

import contextlib
import os
import pty
import subprocess
import sys
import tty
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import serial

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.ports import make_serial_port
from tacshade_edge.settings import Serial


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """The robot's end of a pty, and the name of ours."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    os.close(slave)
    yield master, name
    with contextlib.suppress(OSError):  # a test may have pulled the cable
        os.close(master)


def test_bytes_both_ways(line: tuple[int, str]) -> None:
    master, name = line
    port = SerialPort(name, 115200)
    port.open()
    os.write(master, b"\x00\xff\n\r")
    assert port.read() == b"\x00\xff\n\r"
    assert port.read() == b""  # after its time
    assert port.write(b"\n\x11\x00")
    assert os.read(master, 10) == b"\n\x11\x00"
    assert port.describe() == {"device": name, "baud": 115200}
    port.close()
    port.close()
    with pytest.raises(DeviceError, match="not open"):
        port.read()


def test_a_port_is_for_one_program(line: tuple[int, str]) -> None:
    _, name = line
    port = SerialPort(name, 115200)
    port.open()
    with pytest.raises(DeviceError, match=f"serial {name}: in use by another program"):
        SerialPort(name, 115200).open()
    port.close()
    SerialPort(name, 115200).open()


def test_an_end_that_reads_nothing_is_not_waited_for(line: tuple[int, str]) -> None:
    port = SerialPort(line[1], 115200)
    port.open()
    assert not port.write(b"x" * 100_000)
    port.close()


def test_a_pulled_cable(line: tuple[int, str]) -> None:
    port = SerialPort(line[1], 115200)
    port.open()
    os.close(line[0])
    with pytest.raises(DeviceError, match=f"serial {line[1]}: unplugged"):
        port.read()
    with pytest.raises(DeviceError, match=f"serial {line[1]}: "):
        port.write(b"x")
    port.wake()
    port.close()
    port.wake()


@pytest.mark.parametrize(
    ("device", "error", "why"),
    [
        ("/dev/no-such-port", DeviceError, "no such device"),
        (
            "/etc/hostname",
            ConfigError,
            "found another kind of file, expected a serial port's character device",
        ),
        (
            "foo://x",
            ConfigError,
            "invalid URL, protocol 'foo' not known; expected a device or a pyserial URL",
        ),
        ("socket://127.0.0.1:9", DeviceError, "refused"),
    ],
)
def test_what_cannot_be_opened(device: str, error: type[Exception], why: str) -> None:
    with pytest.raises(error, match=f"serial {device}: .*{why}") as caught:
        SerialPort(device, 115200).open()
    assert "\n" not in str(caught.value)


@pytest.mark.slow
def test_without_a_robot_there_is_no_pyserial(tmp_path: Path) -> None:
    code = (
        "import sys; import tacshade_edge.daemon.app; from tacshade_edge.robot.ports import "
        "make_serial_port; assert make_serial_port(None) is None; print([m for m in sys.modules if "
        "m.split('.')[0] in ('serial', 'scipy') or m == 'tacshade_edge.robot.robot'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("dtr", [True, False])
def test_the_lines_that_reset_a_board_stay_low_where_the_settings_say_so(dtr: bool) -> None:
    settings = Serial(device="loop://", baud=9600, dtr=dtr)
    with pytest.MonkeyPatch.context() as patch:
        opened = list[serial.SerialBase]()
        made = serial.serial_for_url

        def kept(*words: Any, **options: Any) -> serial.SerialBase:
            opened.append(made(*words, **options))
            return opened[-1]

        patch.setattr(serial, "serial_for_url", kept)
        port = make_serial_port(settings)
        assert port is not None
        port.open()
        # pyserial's loop has DTR wired to DSR, and RTS to CTS.
        assert (opened[-1].dsr, opened[-1].cts) == (dtr, dtr)
        port.close()
