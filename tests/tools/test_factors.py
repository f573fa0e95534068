"""The study of the factor that presses show."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.studies.factors import Judged, lines, main


def test_means_and_worst_are_those_of_factors_below_and_above_one() -> None:
    rows = [
        Judged("5", "fast", 0.8, 0.8, 0.6, 0.7),
        Judged("5", "accurate", 0.9, 0.9, 0.8, 0.9),
        Judged("other:31", "fast", 1.1, 1.0, 1.1, 1.5),
    ]
    made = {(line[0], line[1]): line[2:] for line in lines(rows)}
    assert made["5", "fast"] == ["0.80", "0.80", "0.60", "0.70"]
    assert made["factors below 1", "mean"] == ["2 networks", "", "0.70", "0.80"]
    assert made["factors below 1", "worst"] == ["2 networks", "", "0.80", "0.90"]
    assert made["factors above 1", "worst"] == ["1 networks", "", "1.10", "1.50"]
    assert ("factors above 1", "mean") not in {(line[0], line[1]) for line in lines(rows[:2])}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--families", "fourth"], "found 'fourth', expected one of third, layered, oblate"),
        (["--sensors", "other"], "found 'other', expected a seed"),
    ],
)
def test_an_unknown_sensor_is_refused_in_a_line(
    options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(options)
    assert said in capsys.readouterr().err


def test_states_that_are_missing_are_named_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--sensors", "", "--states", str(tmp_path), "--families", "layered"]) == 1
    missing = tmp_path / "layered" / "working-0-ball-0.npz"
    assert capsys.readouterr().err == (
        f"{missing} is missing: solve the family first (README.md)\n"
    )
