"""The head and its line against a printer on a pty."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.fake_printer import FakePrinter, Faults

from tacshade_edge.capture.printer.head import Head
from tacshade_edge.capture.printer.keypress_stop import KeypressStop
from tacshade_edge.capture.printer.line import PrinterLine
from tacshade_edge.capture.printer.safety_stop import SafetyStop, Stopped
from tacshade_edge.capture.terminal import Terminal
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.errors import DeviceError
from tacshade_edge.settings.printer_file import PrinterFile

pytestmark = pytest.mark.slow

LIMITS = PrinterFile(x_mm=[0, 220], y_mm=[0, 220], z_mm=[40, 200], start_mm=[110, 100, 90], feed_mm_s=50)


class Rig:
    """A head on a fake printer, and the person's key."""

    def __init__(self, printer: FakePrinter) -> None:
        self.printer = printer
        read, self.key = os.pipe()
        self.line = PrinterLine(SerialPort(printer.port, 115200))
        with open(os.devnull, "w") as out:
            self.terminal = Terminal(read, out)
        self.head = Head(self.line, LIMITS, KeypressStop(self.terminal))

    def start(self) -> None:
        self.line.connect()
        self.head.prepare(home=True)
        self.head.to_start()


@contextlib.contextmanager
def rig(folder: Path, faults: Faults | None = None, firmware: str = "Marlin 2.1.2") -> Iterator[Rig]:
    with FakePrinter(folder / "hand.csv", faults=faults or Faults(), firmware=firmware) as printer:
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
        assert one.printer.heard[begun - 1 : begun + 5] == ["M110 N0", "M115", "G21", "G90", "M84 S0", "G28"]
        assert one.printer.moves[-1] == (110, 100, 90)
        heights = [z for x, _, z in one.printer.moves if x == 0]
        assert heights == sorted(heights)  # first up, where homing left it, in parts of half a second
        assert one.head.is_free
        one.head.to(80)
        assert not one.head.is_free
        with pytest.raises(SafetyStop, match=r"sideways move: found z at 80.00 mm, expected z at 90.00 mm or above"):
            one.head.over(100, 100)


def test_klipper_homes_and_moves_too(tmp_path: Path) -> None:
    with rig(tmp_path, firmware="Klipper v0.12.0") as one:
        one.start()
        assert "SET_IDLE_TIMEOUT TIMEOUT=86400" in one.printer.heard


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
