"""docs/how-to/mistakes.md: every mistake is made here,
and gets the line and the exit code that the page has for it.
"""

from __future__ import annotations

import csv
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from support.mqtt_rig import free_port
from support.patience import patience, wait_until
from tacshade_edge.cli import main

pytestmark = pytest.mark.slow  # a calibration set is drawn, and calibrated
PAGE = Path(__file__).parents[2] / "docs/how-to/mistakes.md"
ROWS = re.findall(
    r"^\| ([^|`]+) \| `([^`|]+)` \| `([^|]+)` \| ([^|]+) \|$", PAGE.read_text(), re.MULTILINE
)
GOES_ON = "goes on"


def in_px(row: list[str]) -> list[str]:
    """A press's row with its place as read off the image, roughly."""
    *others, x_mm, y_mm = row
    return [*others, f"{328 + 11 * float(x_mm):.0f}", f"{236 + 11 * float(y_mm):.0f}"]


def write_rows(path: Path, header: list[str], rows: list[list[str]]) -> None:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibration set, the same with mistakes in its table, and settings, good and bad."""
    made = tmp_path_factory.mktemp("mistakes")
    assert main(["simulate", "--calibration-set", str(made / "mysensor"), "--presses", "12"]) == 0
    with (made / "mysensor" / "PRESSES.csv").open() as file:
        header, *rows = csv.reader(file)

    def write(name: str, column: str, factor: float) -> None:
        at = header.index(column)
        wrong = [[*row[:at], str(float(row[at]) * factor), *row[at + 1 :]] for row in rows]
        write_rows(made / "mysensor" / name, header, wrong)

    write("CENTIMETRES.csv", "depth_mm", 0.1)
    write("DIAMETERS.csv", "radius_mm", 2.0)
    write_rows(made / "mysensor" / "PIXELS.csv", header, [in_px(row) for row in rows])
    values = [rows[-1], *rows]  # of the row before
    shifted = [[row[0], *other[1:]] for row, other in zip(rows, values, strict=False)]
    write_rows(made / "mysensor" / "SHIFTED.csv", header, shifted)
    circle = "visible_circle: {row_px: 328, col_px: 236, radius_px: 205}\n"
    sensor = (made / "mysensor" / "SENSOR.yaml").read_text()
    (made / "mysensor" / "SWAPPED.yaml").write_text(sensor + circle)
    (made / "key.yaml").write_text("source: {kind: simulated}\nmqtt: {prot: 1883}\n")
    (made / "profile.yaml").write_text("profile: acurate\n")
    return made


def is_said(text: str, line: str) -> bool:
    """Whether a line of `text` is `line`, with anything in the place of its ellipses."""
    pattern = ".*".join(map(re.escape, line.split("…")))
    return re.search(f"(?:^|: ){pattern}$", text, re.MULTILINE) is not None


def test_every_row_is_made_here() -> None:
    assert len(ROWS) == 15
    head_and_rows = [line for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    assert len(head_and_rows) == 1 + len(ROWS)


@pytest.mark.parametrize(
    ("command", "line", "code"),
    [pytest.param(*row, id=what) for what, *row in ROWS if row[2] != GOES_ON],
)
def test_a_mistake_gets_its_line(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    line: str,
    code: str,
) -> None:
    monkeypatch.chdir(folder)
    _, *words = shlex.split(command)
    words = [
        name
        for word in words
        for name in (sorted(map(str, Path().glob(word))) if "*" in word else [word])
    ]
    try:
        ended = main(words)
    except SystemExit as usage:
        ended = int(str(usage.code))
    said = capsys.readouterr()
    assert (ended, said.out) == (int(code), "")
    assert is_said(said.err, line), said.err


@pytest.mark.parametrize(("command", "line"), [row[1:3] for row in ROWS if row[3] == GOES_ON])
def test_a_mistake_that_the_daemon_waits_out_gets_its_line(
    folder: Path, command: str, line: str
) -> None:
    port, log = free_port(), folder / "log"
    (folder / "config.yaml").write_text(
        f"source: {{kind: simulated}}\ncalibration: c.npz\nmqtt: {{port: {port}}}\n"
    )

    def said() -> str:
        return log.read_text().replace(f":{port}", ":1883")

    _, *words = shlex.split(command)
    with (
        log.open("wb") as file,
        subprocess.Popen(
            [sys.executable, "-m", "tacshade_edge", *words], stderr=file, cwd=folder
        ) as child,
    ):
        try:
            wait_until(lambda: is_said(said(), line), 20, "it says so")
        finally:
            child.terminate()
        assert child.wait(patience(10)) == 0
