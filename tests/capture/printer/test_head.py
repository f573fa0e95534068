"""The head and its line against a printer on a pty."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support import fake_printer
from support.fake_printer import Dialect, FakePrinter

from tacshade_edge.capture.live import Terminal
from tacshade_edge.capture.printer import line
from tacshade_edge.capture.printer.head import Head, KeypressStop, segments
from tacshade_edge.capture.printer.line import PrinterLine, SafetyStop, Stopped
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.errors import DeviceError
from tacshade_edge.settings.sensor_file import PrinterFile

pytestmark = pytest.mark.slow

LIMITS = PrinterFile(x_mm=[0, 220], y_mm=[0, 220], z_mm=[40, 200], start_mm=[110, 100, 90], feed_mm_s=50)


class Rig:
    """A head on a fake printer, and the person's key."""

    def __init__(self, printer: FakePrinter) -> None:
        self.printer = printer
        read, self.key = os.pipe()
        self.line = PrinterLine(SerialPort(printer.port, 115200, 5.0))
        with open(os.devnull, "w") as out:
            self.terminal = Terminal(read, out)
        self.head = Head(self.line, LIMITS, KeypressStop(self.terminal))

    def start(self) -> None:
        self.line.connect()
        self.head.prepare(home=True)
        self.head.to_start()


@contextlib.contextmanager
def rig(folder: Path, dialect: Dialect = fake_printer.MARLIN, *, is_homed: bool = False) -> Iterator[Rig]:
    with FakePrinter(folder / "hand.csv", dialect=dialect, is_homed=is_homed) as printer:
        made = Rig(printer)
        try:
            with made.terminal.keys():
                yield made
        finally:
            made.line.close()
            os.close(made.key)


def test_from_a_board_that_restarts_to_the_start(tmp_path: Path) -> None:
    with rig(tmp_path) as one:
        one.start()
        assert one.line.firmware.startswith("Marlin 2.1.2")
        assert one.line.has_restarted
        begun = one.printer.heard.index("M115")
        assert one.printer.heard[begun - 1 : begun + 6] == ["M110 N0", "M115", "M114", "G21", "G90", "M84 S0", "G28"]
        assert one.printer.moves[-1] == (110, 100, 90)
        heights = [z for x, _, z in one.printer.moves if x == 0]
        assert heights == sorted(heights)  # first up, where homing left it, in parts of half a second
        assert one.head.is_free
        one.head.to(80)
        assert not one.head.is_free
        with pytest.raises(SafetyStop, match=r"sideways move: found z at 80.00 mm, expected z at 90.00 mm or above"):
            one.head.over(100, 100)


@pytest.mark.parametrize(
    ("dialect", "idle"),
    [
        (fake_printer.PRUSA, "M84 S0"),
        (fake_printer.PRUSA_BUDDY, "M84 S0"),
        (fake_printer.KLIPPER, "SET_IDLE_TIMEOUT TIMEOUT=86400"),
        (fake_printer.REPRAPFIRMWARE, None),
        (fake_printer.SMOOTHIEWARE, None),
        (fake_printer.ONE_DECIMAL, None),
    ],
    ids=lambda value: value.name if isinstance(value, Dialect) else "",
)
@pytest.mark.parametrize("home", [True, False])
def test_every_firmware_keeps_its_motors_on_and_moves(
    tmp_path: Path, dialect: Dialect, idle: str | None, home: bool
) -> None:
    with rig(tmp_path, dialect, is_homed=not home) as one:
        one.line.connect()
        one.head.prepare(home=home)
        one.head.to_start()
        for z in (85.333, 85.283, 90.0):  # a step of a search
            one.head.to(z)
        one.head.over(101.337, 99.949)
        assert one.printer.is_homed
        assert [c for c in one.printer.heard if c.startswith(("M18", "M84", "SET"))] == ([idle] if idle else [])
        one.printer.faults.highest_mm = 90.5
        with pytest.raises(SafetyStop, match=r"reports the head's position as"):
            one.head.to(91.0)


def test_a_device_that_never_stops_talking_is_no_printer() -> None:
    port: Any = SimpleNamespace(
        device="/dev/p", open=lambda: None, write=lambda _: True, read=lambda: b"T:20.1 /0.0\nok\n", close=lambda: None
    )
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(line, "ANSWER_S", 0.05)
        with pytest.raises(DeviceError, match="printer /dev/p: found 0 s of unrequested lines, expected a printer"):
            PrinterLine(port).connect()


def test_a_printer_that_is_not_homed_is_quoted(tmp_path: Path) -> None:
    with rig(tmp_path, fake_printer.KLIPPER) as one:
        one.line.connect()
        one.head.prepare(home=False)
        with pytest.raises(SafetyStop, match=r"G1 .*!! Must home axis first"):
            one.head.to_start()


@pytest.mark.parametrize(
    ("position", "found"),
    [
        ("X:{x:.0f} Y:{y:.0f} Z:{z:.0f} E:0\nok", r"'X:0 Y:0 Z:0 E:0'"),
        ("<Idle|MPos:{x:.3f},{y:.3f},{z:.3f}|FS:0,0>\nok", r"'<Idle\|MPos:0.000,0.000,0.000\|FS:0,0>'"),
        ("ok N5 P15 B3", r"'N5 P15 B3'"),
        ("ok", "nothing but ok"),
    ],
)
def test_a_position_that_cannot_be_read_ends_it_before_anything_moves(
    tmp_path: Path, position: str, found: str
) -> None:
    with rig(tmp_path, Dialect("any", "FIRMWARE_NAME:any\nok", position)) as one:
        one.line.connect()
        with pytest.raises(SafetyStop, match=f"the printer's answer to M114: found {found}, expected X, Y and Z in mm"):
            one.head.prepare(home=True)
        assert not one.head.was_moved
        assert "G28" not in one.printer.heard


@pytest.mark.parametrize("to", [(230.0, 100.0), (100.0, -1.0), (float("nan"), 100.0)])
def test_nothing_is_sent_beyond_the_limits(tmp_path: Path, to: tuple[float, float]) -> None:
    with rig(tmp_path) as one:
        one.start()
        moves = list(one.printer.moves)
        with pytest.raises(SafetyStop, match=r"expected 0 to 220 mm, the range in PRINTER\.yaml"):
            one.head.over(*to)
        with pytest.raises(SafetyStop, match=r"move: found z 39.00 mm, expected 40 to 200"):
            one.head.to(39.0)
        assert one.printer.moves == moves
        assert one.head.is_certain


def test_a_damaged_line_is_sent_again(tmp_path: Path) -> None:
    with rig(tmp_path) as one:
        one.start()
        one.printer.faults.damaged_line = len(one.printer.heard) + 3
        one.head.to(89.5)
        assert one.printer.faults.damaged_line == 0
        assert one.printer.moves[-1] == (110, 100, 89.5)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("restart", "it restarted and lost its position"),
        ("error", "MAXTEMP triggered"),
        pytest.param("lost_answer", "did not answer G1", marks=pytest.mark.slow),
    ],
)
def test_what_leaves_the_head_uncertain(tmp_path: Path, fault: str, said: str) -> None:
    with rig(tmp_path) as one:
        one.start()
        moved = len(one.printer.moves)
        setattr(one.printer.faults, fault, len(one.printer.heard) + 2)  # the move, after its place was asked for
        with pytest.raises(SafetyStop, match=said):
            one.head.to(85.0)
        assert not one.head.is_certain
        with pytest.raises((SafetyStop, RuntimeError)):
            one.head.to(85.0)
        assert "sent M112" in one.line.emergency_stop()
        assert len(one.printer.moves) <= moved + 1


def test_a_printer_that_goes_elsewhere_and_does_not_say_so(tmp_path: Path) -> None:
    with rig(tmp_path) as one:
        one.start()
        one.printer.faults.highest_mm = 90.5
        with pytest.raises(
            SafetyStop, match=r"position as 110.00, 100.00, 90.50 mm, expected 110.00, 100.00, 91.00 mm"
        ):
            one.head.to(91.0)
        assert not one.head.is_certain


def test_a_key_ends_a_long_move_after_its_present_part(tmp_path: Path) -> None:
    with rig(tmp_path) as one:
        one.start()
        os.write(one.key, b"x")
        with pytest.raises(Stopped, match="a key was pressed"):
            one.head.over(10, 10)
        assert one.printer.moves[-1] == (110, 100, 90)
        assert one.head.is_certain
        one.head.over(110, 60)  # the key was for that move


def test_a_key_ends_homing_and_leaves_the_head_uncertain(tmp_path: Path) -> None:
    with rig(tmp_path) as one:
        one.line.connect()
        os.write(one.key, b" ")
        with pytest.raises(Stopped):
            one.head.prepare(home=True)
        assert one.head.was_moved
        assert not one.head.is_certain


def test_a_halted_printer_and_a_pulled_cable(tmp_path: Path) -> None:
    with rig(tmp_path) as one:
        one.start()
        assert "sent M112" in one.line.emergency_stop()
        with pytest.raises(SafetyStop, match=r"kill\(\) called"):
            one.head.to(89)
    with rig(tmp_path) as one:
        one.start()
        one.printer.pull_the_cable()
        with pytest.raises(DeviceError, match=r"unplugged|is not accepting data on the serial line"):
            one.head.to(89)
        assert "switch the printer off" in one.line.emergency_stop()


@given(st.lists(st.floats(-200, 200), min_size=6, max_size=6), st.floats(0.5, 50))
def test_no_part_of_a_move_is_longer(places: list[float], longest_mm: float) -> None:
    start, end = np.array(places[:3]), np.array(places[3:])
    parts = segments(start, end, longest_mm)
    assert np.array_equal(parts[-1], end)
    assert all(math.dist(a, b) <= longest_mm + 1e-6 for a, b in itertools.pairwise((start, *parts)))
