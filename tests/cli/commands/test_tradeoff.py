import csv
import json
import socket
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.progress_lines import only_progress, without_progress
from support.trade_points import point

from tacshade_edge.cli import main
from tacshade_edge.cli.commands import tradeoff
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.studies.tradeoff.measure import Point, Setting
from tacshade_edge.studies.tradeoff.report import settings_block
from tools.testbed.painted_sensor import FREE, HEIGHT, TOUCHED, WIDTH, painted_calibration


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A calibration, an image of a contact and one without, with their truth."""
    calibration_file.save(tmp_path / "cal.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    rows, cols = np.ogrid[:HEIGHT, :WIDTH]
    coin = np.hypot(rows - 59.5, cols - 79.5) < 20
    for name, image, contact in (("coin", TOUCHED, coin), ("none", FREE, 0 * coin > 0)):
        cv2.imwrite(str(tmp_path / "images" / f"{name}.png"), image)
        np.savez(tmp_path / "images" / f"{name}.npz", height_mm=np.where(contact, 2.0, 0.0), contact=contact)
    return tmp_path


def of_own(folder: Path, *more: str) -> list[str]:
    return ["tradeoff", "--calibration", str(folder / "cal.npz"), "--images", str(folder / "images"), *more]


@pytest.mark.slow  # it starts interpreters
def test_own_images_the_files_and_the_settings(
    own: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tradeoff, "BUSY", 1e9)  # this machine may be
    assert main(of_own(own, "--profile", "fast", "--out", str(own / "out"), "--budget-ms", "10000")) == 0
    printed = capsys.readouterr()
    assert only_progress(printed.err)
    assert printed.out.splitlines()[-1] == "profile: fast"
    written = ["tradeoff.csv", "tradeoff.json", "tradeoff.md", "tradeoff.png"]
    assert sorted(p.name for p in (own / "out").iterdir()) == written
    assert (own / "out" / "tradeoff.md").read_text() in printed.out
    with (own / "out" / "tradeoff.csv").open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert lines[0]["setting"] == "fast"
    assert {(line["presses"], line["untouched"], line["phantoms"]) for line in lines} == {("1", "1", "0")}
    summary = json.loads((own / "out" / "tradeoff.json").read_text())
    assert len(summary["points"]) == len(lines)
    assert summary["data"]["images"] == str(own / "images")


@pytest.mark.slow
def test_a_budget_that_none_keeps_and_a_missing_truth_exit_1(
    own: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tradeoff, "BUSY", 0.0)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    cv2.imwrite(str(own / "images" / "alone.png"), TOUCHED)
    words = of_own(own, "--profile", "fast", "--budget-ms", "0.001", "--json", "--out", str(own / "out"))
    assert main(words) == 1
    printed = capsys.readouterr()
    alone, missing, busy, over = without_progress(printed.err)
    assert "alone.npz: found no such file" in alone
    assert missing.startswith("tacshade-edge: tradeoff.png will be missing without matplotlib")
    assert "the machine was busy: frames took" in busy
    assert "no shipped profile stays within 0.001 ms" in over
    assert json.loads(printed.out) == json.loads((own / "out" / "tradeoff.json").read_text())


def test_the_report_of_a_board_is_of_the_shipped_profiles(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def measured(settings: Sequence[Setting], *_: object) -> tuple[tuple[Point, ...], float]:
        asked.extend(map(str, settings))
        return tuple(point(setting.profile, 0.2, 1.0) for setting in settings), 1.0

    monkeypatch.setattr(tradeoff, "simulated", lambda *_: ())
    monkeypatch.setattr(tradeoff, "score_settings", lambda *_: ())
    monkeypatch.setattr(tradeoff, "weigh_and_time", measured)
    assert main(["tradeoff", "--report"]) == 0
    assert asked == ["fast", "balanced", "accurate"]
    printed = capsys.readouterr().out
    assert "| 1.00 / 2.00 | 1.00 / 2.00 | 1.00 / 2.00 | 0.30 to 0.30 | 12 | 1.0 |" in printed
    assert socket.gethostname() not in printed


def test_the_settings_are_those_of_a_settings_file(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    block = settings_block([point("fast", 0.2, 1.0), point("accurate", 0.1, 3.0)], 6.0)
    config = own / "config.yaml"
    config.write_text(f"calibration: cal.npz\nsource:\n  kind: files\n  path: images/\n{block}\n")
    assert main(["check-config", str(config)]) == 0
    assert capsys.readouterr().out == f"{config}: ok\n"


def test_what_is_not_there_is_one_line_before_the_work(own: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in (own / "images").glob("coin.*"):
        path.unlink()
    assert main(of_own(own)) == 78
    assert "found no image of a contact to score" in capsys.readouterr().err
    assert main(["tradeoff", "--out", str(own / "cal.npz")]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "cal.npz: cannot write it" in error
