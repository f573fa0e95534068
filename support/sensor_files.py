"""The files that a person hands to `calibrate`, from the simulated sensor."""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import pytest
import yaml

from support.calibrated_sensor import HALF, presses, references
from tacshade_edge.cli import main


def write_files(folder: Path) -> list[str]:
    """Write SENSOR.yaml, PRESSES.csv and their images;
    return the words that `calibrate` needs for them.
    """
    keys = {
        "skin_radius_mm": HALF.skin_radius_mm,
        "camera_distance_mm": HALF.camera_distance_mm,
        "visible_half_angle_deg": HALF.visible_half_angle_deg,
        "polarity": "bright",
    }
    (folder / "SENSOR.yaml").write_text(yaml.safe_dump(keys))
    names = []
    for k, image in enumerate(references()):
        names.append(str(folder / f"reference{k}.png"))
        cv2.imwrite(names[-1], image)
    rows = ["image,indenter,radius_mm,depth_mm,x_mm,y_mm"]
    for k, press in enumerate(presses()):
        cv2.imwrite(str(folder / f"press{k}.png"), press.image)
        rows.append(
            f"press{k}.png,ball,{press.radius_mm},{press.depth_mm},{press.x_mm},{press.y_mm}"
        )
    (folder / "PRESSES.csv").write_text("\n".join(rows) + "\n")
    return [
        "--sensor",
        str(folder / "SENSOR.yaml"),
        "--presses",
        str(folder / "PRESSES.csv"),
        "--reference",
        *names,
    ]


def with_table(words: list[str], path: Path, rows: list[list[str]]) -> list[str]:
    """The words of `calibrate` with another table,
    whose first column names images of the first one.
    """
    folder = Path(words[3]).parent
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows(
            [rows[0], *([str(folder / row[0]), *row[1:]] for row in rows[1:])]
        )
    return [*words[:3], str(path), *words[4:]]


def rows_of(words: list[str]) -> list[list[str]]:
    return [line.split(",") for line in Path(words[3]).read_text().splitlines()]


def refused(command: list[str], capsys: pytest.CaptureFixture[str], code: int = 78) -> str:
    """The one line of a command that makes no file."""
    assert main(command) == code
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert text.startswith("tacshade-edge: ")
    assert not Path(command[command.index("--out") + 1]).exists()
    return text
