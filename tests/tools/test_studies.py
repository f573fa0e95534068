"""What every study shares, by the study of drag: its table and its rows."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from support.calibrated_sensor import calibrated
from support.half_family import half_family
from support.progress_lines import only_progress
from tacshade_edge.calibration.files import calibration_file
from tools.studies import drag


@pytest.mark.slow
def test_a_study_writes_its_table_and_its_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drag, "DIRECTIONS", 1)
    words = ["--objects", "ball", "--profile", "fast", "--references", "1", "--presses", "8"]
    with half_family():
        drag.main(["--sensors", "half:default", *words, "--out", str(tmp_path)])
    reported = capsys.readouterr()
    assert only_progress(reported.err)
    assert reported.out == (tmp_path / "drag.md").read_text(encoding="utf-8")
    with (tmp_path / "drag.csv").open(encoding="utf-8") as file:
        assert len(list(csv.DictReader(file))) == 5 * 3


@pytest.mark.slow
def test_a_study_judges_the_sensors_that_were_fitted_to_references(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(drag, "DIRECTIONS", 1)
    calibration_file.save(tmp_path / "half_default_none.npz", calibrated())
    calibration_file.save(tmp_path / "half_default.npz", calibrated())  # with presses
    with half_family():
        drag.main(
            [
                "--fitted",
                str(tmp_path),
                "--objects",
                "ball",
                "--profile",
                "fast",
                "--out",
                str(tmp_path / "out"),
            ]
        )
    with (tmp_path / "out" / "drag.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 5 * 3
    assert {row["sensor"] for row in rows} == {"half:default"}
    assert not any(
        line.startswith("sensors calibrated") for line in capsys.readouterr().err.splitlines()
    )
