"""The programs of the studies: what they write, and what they refuse."""

from __future__ import annotations

import csv
import importlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from support.half_family import half_family
from support.progress_lines import only_progress

from tools.studies import evaluate

STUDIES = ("drag", "limits", "sigma", "slip")
ONE_OBJECT = ["--objects", "ball", "--profile", "fast", "--references", "1", "--presses", "8"]


def program(name: str) -> Any:
    return importlib.import_module(f"tools.studies.{name}.__main__")


def table(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture
def half() -> Iterator[None]:
    with half_family():
        yield


def printed(capsys: pytest.CaptureFixture[str]) -> str:
    out = capsys.readouterr()
    assert only_progress(out.err)
    return out.out


@pytest.mark.slow
@pytest.mark.usefixtures("half")
def test_limits_writes_its_tables_and_plots(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = program("limits")
    small = partial(
        limits.Plan,
        references=1,
        presses=8,
        null_frames=8,
        beyond_frames=5,
        ball_radii_mm=(6.0,),
        faint_depths_mm=(1.0,),
        faint_places=1,
        depths_mm=(3.0,),
        deep_places=1,
        pitches_mm=(1.9,),
        gaps_mm=(4.0,),
        widths_mm=(2.0,),
        fine_places=1,
        disturbed_places=1,
    )
    monkeypatch.setattr(limits, "Plan", small)
    limits.main(["--sensors", "half:default", "--profile", "accurate", "--out", str(tmp_path)])
    assert printed(capsys) == (tmp_path / "limits.md").read_text(encoding="utf-8")
    kinds = ("deep", "disturbed", "faint", "fine", "nulls")
    assert sorted(p.name for p in tmp_path.glob("*.csv")) == [f"limits_{kind}.csv" for kind in kinds]
    assert len(list(tmp_path.glob("limits_*.png"))) == 4
    assert {row["profile"] for row in table(tmp_path / "limits_faint.csv")} == {"accurate"}


@pytest.mark.slow
@pytest.mark.usefixtures("half")
@pytest.mark.parametrize(("name", "count"), [("drag", 5 * 4 * 3), ("sigma", 2 * 4 * 3)])
def test_one_writes_its_table_and_plot(
    name: str, count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    program(name).main(["--sensors", "half:default", *ONE_OBJECT, "--out", str(tmp_path)])
    assert printed(capsys) == (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    assert len(table(tmp_path / f"{name}.csv")) == count
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("drag", ["--presses", "3"], "--presses: found 3, expected 0 or at least 8"),
        ("sigma", ["--presses", "3"], "--presses: found 3"),
        ("sigma", ["--profile", "paper"], "found paper, which gives no errors"),
        ("slip", ["--sensors", "other:31"], "--sensors: only the family tacshade"),
        *((name, ["--sensors", "5", "--final"], "not allowed with argument --sensors") for name in STUDIES),
    ],
)
def test_usage_mistakes_exit_2(name: str, words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        program(name).main(words)
    assert left.value.code == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--sensors", "5,tacshade:12345"], "--sensors: seeds from 9000 on are kept for --final"),
        (["--sensors", "5", "--final"], "--final does not go with --sensors"),
        (["--final", "--calibration", "x", "--images", "x"], "--sensors is for simulated sensors"),
    ],
)
def test_evaluate_keeps_the_final_sensors(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        evaluate.main(words)
    assert left.value.code == 2
    assert message in capsys.readouterr().err


def test_an_output_that_is_a_file_is_one_line_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit) as left:
        program("limits").main(["--out", str(tmp_path / "file")])
    assert left.value.code == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "file: cannot write it" in error
