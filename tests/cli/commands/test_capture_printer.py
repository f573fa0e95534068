"""A printer on a pty that presses the simulated sensor, and a person at a terminal who watches it."""

from __future__ import annotations

import json
import math
import signal
from collections.abc import Iterator
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
from support.fake_printer import FakePrinter, Mounted
from support.person import goes_to_the_skin, person

from tacshade_edge.cli import main
from tacshade_edge.storage.tables.capture_folder import CaptureFolder
from tacshade_edge.storage.tables.indenters import read_indenters
from tacshade_edge.storage.tables.presses import read_presses

PRINTER = "x_mm: [0, 220]\ny_mm: [0, 220]\nz_mm: [40, 200]\nstart_mm: [100, 100, 78]\nfeed_mm_s: 50\n"
PLAN = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n,ball,6,2.5,1,-3\n,cube,,1.5,0,2\n"


@pytest.fixture
def words(tmp_path: Path, sensor_yaml: str) -> list[str]:
    """What is typed after ``capture``, but the port."""
    out = tmp_path / "out"
    out.mkdir()
    (tmp_path / "sim.yaml").write_text("source: {kind: simulated, fps: 30, pressed: hand.csv}\n")
    (out / "SENSOR.yaml").write_text(sensor_yaml)
    (out / "PRINTER.yaml").write_text(PRINTER)
    (out / "INDENTERS.yaml").write_text("cube: {shape: box, length_mm: 10, width_mm: 10}\n")
    (tmp_path / "PLAN.csv").write_text(PLAN)
    return [str(out), "--config", str(tmp_path / "sim.yaml"), "--plan", str(tmp_path / "PLAN.csv"), "--printer"]


@pytest.fixture
def printer(tmp_path: Path) -> Iterator[FakePrinter]:
    with FakePrinter(tmp_path / "hand.csv") as made:
        yield made


@pytest.mark.slow
def test_presses_as_a_hand_would_take_them(words: list[str], printer: FakePrinter) -> None:
    with person(*words, printer.port) as one:
        one.hears("then type home (G28)")
        one.types("home")
        one.hears("Mount the sensor under the head")
        one.types("")
        one.hears("Enter takes 10 references")
        one.types("")
        one.hears("the sensor: its axis at x ")
        one.hears("turned by 3")  # of 33 degrees
        one.hears("press_001.png: ball of 6 mm, 2.5 mm deep at x 1, y -3 mm")
        one.hears("Mount cube")
        printer.mount(Mounted("cube", "", 1.4))
        one.types("")
        one.hears("press_002.png: cube, 1.5 mm deep at x 0, y 2 mm, yaw_deg -3")
        assert one.ends() == 0
        assert "next:" in one.heard
    folder = CaptureFolder(Path(words[0]))
    ball, cube = read_presses(folder.presses, read_indenters(folder.indenters))[0]
    assert (ball.depth_mm, ball.yaw_deg) == (2.5, 0)
    assert math.isclose(cube.yaw_deg, -printer.sensor.yaw_deg, abs_tol=2)
    sensor, tip_z = printer.sensor, printer.sensor.tip_z_mm
    pressed = min((move for move in printer.moves if move[0] > 50), key=lambda move: move[2])
    assert math.dist(pressed[:2], (sensor.x_mm, sensor.y_mm)) < 5
    assert tip_z - 3.0 < pressed[2]  # the ball's 2.5 mm at the side of the tip
    printer.mount(Mounted())
    with person(*words, printer.port) as one:
        assert one.ends() == 0
        assert "all planned presses are taken" in one.heard


@pytest.mark.slow
@pytest.mark.parametrize("how", ["key", "interrupt", "terminate"])
def test_a_hand_stops_it_while_it_presses(words: list[str], printer: FakePrinter, how: str) -> None:
    with person(*words, printer.port) as one:
        goes_to_the_skin(one)
        printer.wait_until_below(printer.sensor.tip_z_mm)
        if how == "key":
            one.types_key(" ")
        else:
            one.process.send_signal(signal.SIGINT if how == "interrupt" else signal.SIGTERM)
        code = one.ends()
    if how == "interrupt":
        assert code == 130
        assert printer.halted
        assert "sent M112: the printer stands still" in one.heard
    else:
        assert code == 1
        assert "stopped: " in one.heard
        # Amid a command the position of the head is not certain.
        assert printer.halted or printer.moves[-1][2] >= printer.sensor.tip_z_mm + 4
        assert printer.halted == ("sent M112" in one.heard)


@pytest.mark.slow
def test_another_circle_ends_what_was_found_with_the_old_one(words: list[str], printer: FakePrinter) -> None:
    with person(*words, printer.port) as one:
        one.hears("live picture: ")
        one.hears("\n")
        address = one.before.strip()
        goes_to_the_skin(one)
        rim = {"points": [[60, 320], [240, 140], [420, 320]]}
        headers = {"Origin": address.rstrip("/")}
        asked = Request(f"{address.rstrip('/')}/circle", json.dumps(rim).encode(), headers)
        with urlopen(asked) as answer:
            assert answer.read() == b"using your three points"
        one.hears("the visible circle changed")
        assert one.ends() == 1
    assert not printer.halted
    assert printer.moves[-1][2] >= printer.sensor.tip_z_mm + 4
    assert "visible_circle" in (Path(words[0]) / "SENSOR.yaml").read_text()


def test_what_cannot_work_is_told_before_the_port_is_opened(
    words: list[str], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(["capture", *words, "/dev/no-such-port"]) == 1
    assert "serial /dev/no-such-port: no such device" in capfd.readouterr().err
    (tmp_path / "PLAN.csv").write_text("image,indenter,radius_mm,depth_mm,x_mm,y_mm\n,ball,6,2,0,16\n")
    assert main(["capture", *words, "/dev/no-such-port"]) == 78
    assert "from the skin's axis, expected at most " in capfd.readouterr().err
    (Path(words[0]) / "PRINTER.yaml").write_text("x_mm: [0, 220]\n")
    assert main(["capture", *words, "/dev/no-such-port"]) == 78
    assert all("PRINTER.yaml" in line for line in capfd.readouterr().err.splitlines())
