"""What images contradict names the file, the key and the problem."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.calibration.inputs import Contradiction, ContradictionError


def test_contradictions_name_their_files_as_usual_or_by_path() -> None:
    error = ContradictionError(
        Contradiction("PRESSES.csv", "depth_mm", "found PRESSES.csv: odd"),
        Contradiction("SENSOR.yaml", "polarity", "found dark, expected bright"),
    )
    assert str(error) == (
        "PRESSES.csv: depth_mm: found PRESSES.csv: odd; "
        "SENSOR.yaml: polarity: found dark, expected bright"
    )
    assert str(error.with_paths(Path("a/s.yaml"), Path("p.csv"))) == (
        "p.csv: depth_mm: found PRESSES.csv: odd; a/s.yaml: polarity: found dark, expected bright"
    )
