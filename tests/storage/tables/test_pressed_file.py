from __future__ import annotations

import os
from pathlib import Path

import pytest

from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.tables.pressed_file import HEADER, PressedFile


def replace(path: Path, *rows: str) -> None:
    beside = path.with_suffix(".part")
    beside.write_text("\n".join((",".join(HEADER), *rows)) + "\n")
    os.replace(beside, path)


def test_it_is_what_the_file_says_now(tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    script = PressedFile(path)
    assert script.at(0) == ()
    replace(path, "ball,6,2.5,1,-3", "cube,,1,0,0")
    first, second = script.at(1)
    assert (first.shape.name, first.depth_mm, first.x_mm, first.y_mm) == ("ball", 2.5, 1.0, -3.0)
    assert second.shape.name == "cube"
    assert script.at(2) == (first, second)
    replace(path)
    assert script.at(3) == ()


def test_an_object_may_be_turned(tmp_path: Path) -> None:
    path = tmp_path / "hand.csv"
    path.write_text("indenter,radius_mm,depth_mm,x_mm,y_mm,yaw_deg\ncube,,1,0,0,30\nball,6,1,0,0,\n")
    cube, ball = PressedFile(path).at(0)
    assert (cube.rotation_deg, ball.rotation_deg) == (30, 0)


@pytest.mark.parametrize("row", ["ball,six,1,0,0", "egg,,1,0,0", "cube,3,1,0,0", "ball,-1,1,0,0", "ball,6,1"])
def test_what_cannot_be_understood_is_told_once(tmp_path: Path, row: str) -> None:
    path = tmp_path / "hand.csv"
    script = PressedFile(path)
    replace(path, row)
    with pytest.raises(DecodeError):
        script.at(0)
    assert script.at(1) == ()
