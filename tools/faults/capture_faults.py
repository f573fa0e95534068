"""`capture` is killed at each step, by hand and with a printer; the next `capture` continues in the same folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.storage.tables.capture_folder import CaptureFolder
from tacshade_edge.storage.tables.presses import read_presses
from tools.faults.rig import Cell, Seen, pause
from tools.testbed.fake_printer import FakePrinter
from tools.testbed.person import Person, goes_to_the_skin, person

REFERENCES, ASKED = "Enter takes 10 references.", "press 1"
DEEPEST_MM = 5.0
"""Greatest depth below the tip; the press requests half of it."""
AFTER_S = (0.0, 0.2, 0.4, 0.8, 1.6)
SENSOR = "skin_radius_mm: 20\nvisible_half_angle_deg: 50\ncamera_distance_mm: 14\npolarity: bright\n"
PRINTER = "x_mm: [0, 220]\ny_mm: [0, 220]\nz_mm: [40, 200]\nstart_mm: [100, 100, 78]\nfeed_mm_s: 50\n"


def _press(folder: Path, row: str = "") -> None:
    beside = folder / "hand.part"
    beside.write_text(f"indenter,radius_mm,depth_mm,x_mm,y_mm\n{row}\n")
    os.replace(beside, folder / "hand.csv")


def _words(folder: Path, plan: str) -> list[str]:
    (folder / "sim.yaml").write_text("source: {kind: simulated, fps: 30, pressed: hand.csv}\n")
    (folder / "PLAN.csv").write_text(f"image,indenter,radius_mm,depth_mm,x_mm,y_mm\n{plan}")
    return [str(folder / "out"), "--config", str(folder / "sim.yaml"), "--plan", str(folder / "PLAN.csv")]


def _kill(one: Person) -> None:
    one.process.kill()
    one.process.wait()


def _whole(out: Path) -> tuple[int, int]:
    """Count references and presses, and check that each row has its image and that `calibrate` can read every file."""
    folder = CaptureFolder(out)
    if folder.sensor.exists():
        read_sensor(folder.sensor)
    presses = read_presses(folder.presses)[0] if folder.presses.exists() else []
    return len(folder.references()), len(presses)


def killed_by_hand(cell: Cell) -> Seen:
    """Kill `capture` in each dialogue, and shortly after each answer."""
    _press(cell.folder)
    words = _words(cell.folder, ",ball,6,2.5,1,-3\n" * 40)
    out, kills, slowest_s = cell.folder / "out", 0, 0.0
    answers = ("20", "50", "14", "bright")
    for answered in range(len(answers) + 1):
        with person(*words) as one:
            one.hears("Radius of the undeformed skin")
            for answer in answers[:answered]:
                one.types(answer)
            pause(0.1)
            _kill(one)
        kills += 1
        _whole(out)
    (out / "SENSOR.yaml").write_text(SENSOR)
    for after_s in AFTER_S:
        with person(*words) as one:
            if one.hears(REFERENCES, ASKED) == REFERENCES:
                one.types("")
            pause(after_s)
            _kill(one)
        kills += 1
        assert _whole(out)[0] in (0, 10), _whole(out)
    with person(*words) as one:
        if one.hears(REFERENCES, ASKED) == REFERENCES:
            one.types("")
            one.hears("10 references, noise")
            one.hears(ASKED)
        _kill(one)
    acknowledged = 0
    _press(cell.folder, "ball,6,2.5,1,-3")
    for after_s in AFTER_S:
        since_s = time.monotonic()
        with person(*words) as one:
            one.hears(f"this folder already has 10 references and {acknowledged} presses")
            one.hears("planned presses left")
            slowest_s = max(slowest_s, time.monotonic() - since_s)
            one.types("")
            one.hears(f"press_{acknowledged + 1:03d}.png: ball")
            one.hears("planned presses left")
            one.types("")
            pause(after_s)
            _kill(one)
        kills += 1
        references, found = _whole(out)
        assert references == 10
        assert found in (acknowledged + 1, acknowledged + 2), (found, acknowledged)
        acknowledged = found
    return Seen(
        None, slowest_s, f"nothing of {acknowledged} presses in {kills} kills", "`capture`: what is here already"
    )


def _with_a_printer(cell: Cell) -> list[str]:
    """Make the command's arguments except the port."""
    out = cell.folder / "out"
    out.mkdir(exist_ok=True)
    (out / "SENSOR.yaml").write_text(SENSOR)
    (out / "PRINTER.yaml").write_text(PRINTER)
    return [*_words(cell.folder, ",ball,6,2.5,1,-3\n"), "--printer"]


def killed_with_a_printer(cell: Cell) -> Seen:
    """Kill `capture` while the head moves; the next `capture` homes the printer again and takes the press."""
    words, out = _with_a_printer(cell), cell.folder / "out"
    with FakePrinter(cell.folder / "hand.csv") as printer:
        with person(*words, printer.port) as one:
            goes_to_the_skin(one)
            printer.wait_until_below(printer.sensor.tip_z_mm)
            _kill(one)
        assert _deepest(printer) > printer.sensor.tip_z_mm - DEEPEST_MM
        assert _whole(out) == (10, 0)
        since_s = time.monotonic()
        with person(*words, printer.port) as one:
            _answer_until_pressed(one)
            assert one.ends() == 0, one.heard
        assert _deepest(printer) > printer.sensor.tip_z_mm - DEEPEST_MM
    assert _whole(out) == (10, 1)
    return Seen(None, time.monotonic() - since_s, "the press under way", "`capture`: what is here already")


def printer_fails(fault: str, said: str) -> Callable[[Cell], Seen]:
    """Make a fault of `tools.testbed.fake_printer`, or pull the cable, while the head moves to the skin."""

    def fault_of(cell: Cell) -> Seen:
        words = _with_a_printer(cell)
        with FakePrinter(cell.folder / "hand.csv") as printer, person(*words, printer.port) as one:
            goes_to_the_skin(one)
            if fault == "loses_steps_below_mm":
                one.hears("dry run")  # `capture` knows all places, and from now on the head is not where it should be
            since_s = time.monotonic()
            if fault == "cable":
                printer.pull_the_cable()
            elif fault.endswith("_mm"):
                setattr(printer.faults, fault, printer.sensor.tip_z_mm)
            else:
                setattr(printer.faults, fault, len(printer.heard) + 2)
            one.hears(said)
            detected_s = time.monotonic() - since_s
            code = one.ends()
            assert "Traceback" not in one.before + one.heard, one.heard
            deepest_mm = printer.sensor.tip_z_mm - _deepest(printer)
        assert deepest_mm < DEEPEST_MM, deepest_mm
        assert (code, *_whole(cell.folder / "out")) == (1, 10, 0), code
        return Seen(detected_s, None, "the press under way", f"`capture`: {said!r}, exit code 1")

    return fault_of


def printer_hears_badly(cell: Cell) -> Seen:
    """A line reaches the printer damaged; `capture` sends it again, and the head continues."""
    words = _with_a_printer(cell)
    with FakePrinter(cell.folder / "hand.csv") as printer, person(*words, printer.port) as one:
        goes_to_the_skin(one)
        at = printer.faults.damaged_line = len(printer.heard) + 2
        cell.until(lambda: len(printer.heard) > at + 40, 60, "the printer hears more")
        assert printer.faults.damaged_line == 0
        assert one.process.poll() is None
    return Seen(None, None, "nothing: the line is sent again", "")


def _answer_until_pressed(one: Person) -> None:
    asked = ("type home (G28)", "Mount ", REFERENCES, "press_001.png: ball")
    while (heard := one.hears(*asked)) != asked[-1]:
        one.types("home" if heard == asked[0] else "")


def _deepest(printer: FakePrinter) -> float:
    """The head's lowest height over the sensor, away from the homing position."""
    return min(move[2] for move in printer.moves if move[0] > 50)


FAULTS = {
    "`capture` killed (-9) at each step": killed_by_hand,
    "`capture` killed (-9) while the printer presses": killed_with_a_printer,
    "the printer gets a damaged line": printer_hears_badly,
    **{
        f"the printer {name}": printer_fails(fault, said)
        for name, fault, said in (
            ("loses an answer", "lost_answer", "did not answer G1"),
            ("says that it has an error", "error", "MAXTEMP triggered"),
            ("restarts", "restart", "it restarted"),
            ("halts", "halts_below_mm", "kill() called"),
            ("loses steps", "loses_steps_below_mm", "expected contact"),
            ("is unplugged", "cable", "serial"),
        )
    },
}
