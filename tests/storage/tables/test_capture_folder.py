from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.storage.tables.capture_folder import CaptureFolder, Stated, read_plan, stated
from tacshade_edge.storage.tables.presses import BALL, MORE, read_presses

IMAGE = np.zeros((16, 16), np.uint8)
HEADER = "image,indenter,radius_mm,depth_mm,x_mm,y_mm"


def press(depth_mm: str = "2.5") -> Stated:
    return stated("press", (BALL, "6", depth_mm, "1", "-3"), (), 20.0)


def test_what_is_added_is_what_calibrate_reads(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    first = folder.add([], IMAGE, press())
    second = folder.add([first], IMAGE, stated("press", (BALL, "4", "1", "", ""), (), 20.0))
    assert folder.taken() == [first, second]
    read, _ = read_presses(folder.presses)
    assert [(one.radius_mm, one.depth_mm, one.x_mm, one.y_mm) for one in read] == [(6, 2.5, 1, -3), (4, 1, None, None)]


def test_a_press_that_is_taken_back_leaves_nothing_and_no_number_twice(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    first = folder.add([], IMAGE, press())
    second = folder.add([first], IMAGE, press("1.5"))
    folder.remove([first, second], first)
    assert folder.taken() == [second]
    assert folder.add([second], IMAGE, press()).image == "press_003.png"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["PRESSES.csv", "press_002.png", "press_003.png"]


def test_new_references_replace_the_old(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    folder.write_references([IMAGE] * 3)
    folder.write_references([IMAGE] * 2)
    assert len(folder.references()) == 2


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (("cube", "", "1", "", ""), "indenter: found 'cube', expected ball or flat"),
        (("flat", "3", "1", "", ""), "radius_mm: found '3', expected nothing"),
        ((BALL, "0", "1", "", ""), "radius_mm: found 0, expected a number above 0"),
        ((BALL, "six", "1", "", ""), "radius_mm: found 'six', expected a number"),
        ((BALL, "6", "20", "", ""), "depth_mm: found 20, expected a number above 0 and below"),
        ((BALL, "6", "1", "1", ""), "x_mm, y_mm: found only one value"),
        ((BALL, "6", "1", "15", "15"), "x_mm, y_mm: found 15, 15 mm, expected a place within the"),
        ((BALL, "6", "1", "nan", "0"), "x_mm: found 'nan', expected a number"),
    ],
)
def test_what_cannot_be_a_press_is_refused(columns: tuple[str, ...], said: str) -> None:
    with pytest.raises(ConfigError, match=f"^press: {said}"):
        stated("press", columns, ("flat",), 20.0)


def test_a_plan_is_a_table_whose_images_do_not_matter(tmp_path: Path) -> None:
    plan = tmp_path / "PLAN.csv"
    plan.write_text(f"{HEADER}\n,ball,6,2.5,1,-3\n")
    assert read_plan(plan, (), 20.0) == (press(),)
    plan.write_text(f"{HEADER},{','.join(MORE)}\n,flat,,2.5,1,-3,30,0,0,0,0\n")
    (tilted,) = read_plan(plan, ("flat",), 20.0)
    assert str(tilted) == (
        "flat, 2.5 mm deep at x 1, y -3 mm, yaw_deg 30, tilt_x_deg 0, tilt_y_deg 0, shear_x_mm 0, shear_y_mm 0"
    )
    folder = CaptureFolder(tmp_path)
    both = [folder.add([], IMAGE, press())]
    both.append(folder.add(both, IMAGE, tilted))
    assert [one.stated.columns[5:] for one in folder.taken()] == [(), ("30", "0", "0", "0", "0")]
    plan.write_text(f"{HEADER}\n")
    with pytest.raises(ConfigError, match="found no press"):
        read_plan(plan, (), 20.0)


def test_an_image_that_was_deleted_is_named(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    folder.add([], IMAGE, press())
    (tmp_path / "press_001.png").unlink()
    with pytest.raises(ConfigError, match=r"PRESSES.csv:2: image: found no file press_001.png"):
        folder.taken()


def test_a_folder_that_cannot_be_made_is_a_device_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="cannot write it"):
        CaptureFolder(tmp_path / "file" / "out").make()
