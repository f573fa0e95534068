from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.devices.files.presses import read_presses
from tacshade_edge.errors import ConfigError

HEADER = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
GOOD = "a.png,ball,4.5,2,1.5,-3\n"


def table(folder: Path, text: str | bytes) -> Path:
    cv2.imwrite(str(folder / "a.png"), np.full((6, 8), 9, np.uint8))
    path = folder / "PRESSES.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_rows_become_presses(tmp_path: Path) -> None:
    first, second = read_presses(table(tmp_path, HEADER + GOOD + "\n" + "a.png,ball,4.5,2e0,,\n"))
    assert (first.radius_mm, first.depth_mm, first.x_mm, first.y_mm) == (4.5, 2.0, 1.5, -3.0)
    assert (second.x_mm, second.y_mm) == (None, None)
    assert first.image.shape == (6, 8)
    assert first.name == f"{tmp_path}/PRESSES.csv:2: a.png"
    assert second.name.startswith(f"{tmp_path}/PRESSES.csv:4:")


def test_a_table_from_a_spreadsheet_is_read(tmp_path: Path) -> None:
    assert len(read_presses(table(tmp_path, b"\xef\xbb\xbf" + (HEADER + GOOD).replace("\n", "\r\n").encode()))) == 1


def test_a_header_alone_has_no_press(tmp_path: Path) -> None:
    assert read_presses(table(tmp_path, HEADER)) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"PRESSES\.csv:1: found the header nothing, expected image,indenter"),
        (GOOD, r":1: found the header a\.png"),
        (HEADER + "a.png,ball,4.5,2\n", ":2: found 4 columns, expected 6"),
        (HEADER + GOOD + "a.png,ball,4.5,2,1,2,3\n", ":3: found 7 columns, expected 6"),
        (HEADER + "a.png,cube,4.5,2,,\n", ":2: indenter: found 'cube', expected ball"),
        (HEADER + "a.png,ball,big,2,,\n", ":2: radius_mm: found 'big', expected a number"),
        (HEADER + "a.png,ball,4.5,,,\n", ":2: depth_mm: found '', expected a number"),
        (HEADER + "a.png,ball,4.5,nan,,\n", ":2: depth_mm: found 'nan', expected a number"),
        (HEADER + "a.png,ball,4.5,inf,,\n", ":2: depth_mm: found 'inf', expected a number"),
        (HEADER + "a.png,ball,4.5,2,1,\n", ":2: x_mm, y_mm: found one of them, expected both or none"),
        (HEADER + "none.png,ball,4.5,2,,\n", r":2: image: .*none\.png: No such file"),
        (HEADER + "PRESSES.csv,ball,4.5,2,,\n", ":2: image: .*no image"),
        (HEADER + ",ball,4.5,2,,\n", ":2: image: "),
        (HEADER.encode() + b"\xff\xfe\n", "not a CSV file"),
        (HEADER + '"a.png,ball\n', "not a CSV file"),
        (HEADER.encode() + b"a\0.png,ball,4.5,2,,\n", ":2: image: .*embedded null byte"),
    ],
)
def test_a_wrong_table_is_told_by_line_and_column(tmp_path: Path, text: str | bytes, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refusal:
        read_presses(table(tmp_path, text))
    assert "\n" not in str(refusal.value)
    assert "PRESSES.csv" in str(refusal.value)


def test_no_table(tmp_path: Path) -> None:
    for path in (tmp_path / "none.csv", tmp_path):
        with pytest.raises(ConfigError, match="expected a CSV file of presses"):
            read_presses(path)
