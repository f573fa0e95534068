from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.calibration.files.capture_folder import CaptureFolder
from tacshade_edge.calibration.files.labels import LabelFolder, LabelRow, read_labels
from tacshade_edge.calibration.files.press_table import (
    BALL,
    MORE,
    Stated,
    read_plan,
    read_presses,
    stated,
)
from tacshade_edge.calibration.indenters import cylinder
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.files import tables

IMAGE = np.zeros((16, 16), np.uint8)
PLAN_HEADER = "image,indenter,radius_mm,depth_mm,x_mm,y_mm"


def press(depth_mm: str = "2.5") -> Stated:
    return stated("press", (BALL, "6", depth_mm, "1", "-3"), (), 20.0)


def test_what_is_added_is_what_calibrate_reads(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    first = folder.add([], IMAGE, press())
    second = folder.add([first], IMAGE, stated("press", (BALL, "4", "1", "", ""), (), 20.0))
    assert folder.taken() == [first, second]
    read, _ = read_presses(folder.presses)
    assert [(one.radius_mm, one.depth_mm, one.x_mm, one.y_mm) for one in read] == [
        (6, 2.5, 1, -3),
        (4, 1, None, None),
    ]


def test_a_press_that_is_taken_back_leaves_nothing_and_no_number_twice(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    first = folder.add([], IMAGE, press())
    second = folder.add([first], IMAGE, press("1.5"))
    folder.remove([first, second], first)
    assert folder.taken() == [second]
    assert folder.add([second], IMAGE, press()).image == "press_003.png"
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "PRESSES.csv",
        "press_002.png",
        "press_003.png",
    ]


def test_new_references_replace_the_old(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    folder.write_references([IMAGE] * 3)
    folder.write_references([IMAGE] * 2)
    assert len(folder.references()) == 2


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (
            ("cube", "", "1", "", ""),
            r"indenter: found 'cube', expected ball or one of INDENTERS.yaml: flat",
        ),
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
    plan.write_text(f"{PLAN_HEADER}\n,ball,6,2.5,1,-3\n")
    assert read_plan(plan, (), 20.0) == (press(),)
    plan.write_text(f"{PLAN_HEADER},{','.join(MORE)}\n,flat,,2.5,1,-3,30,0,0,0,0\n")
    (tilted,) = read_plan(plan, ("flat",), 20.0)
    assert str(tilted) == (
        "flat, 2.5 mm deep at x 1, y -3 mm, yaw_deg 30, tilt_x_deg 0, tilt_y_deg 0, shear_x_mm 0, "
        "shear_y_mm 0"
    )
    folder = CaptureFolder(tmp_path)
    both = [folder.add([], IMAGE, press())]
    both.append(folder.add(both, IMAGE, tilted))
    assert [one.stated.columns[5:] for one in folder.taken()] == [(), ("30", "0", "0", "0", "0")]
    plan.write_text(f"{PLAN_HEADER}\n")
    with pytest.raises(ConfigError, match="found no press"):
        read_plan(plan, (), 20.0)


def test_a_table_that_capture_cannot_go_on_with(tmp_path: Path) -> None:
    folder = CaptureFolder(tmp_path)
    folder.add([], IMAGE, press())
    (tmp_path / "press_001.png").unlink()
    with pytest.raises(ConfigError, match=r"PRESSES.csv:2: image: found no file press_001.png"):
        folder.taken()
    folder.presses.write_text(f"{PLAN_HEADER},who\n")
    with pytest.raises(
        ConfigError, match=r"PRESSES.csv: ignoring unknown columns: who; delete these columns"
    ):
        folder.taken()
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError, match="cannot write it"):
        CaptureFolder(tmp_path / "file" / "out").make()


HEADER = "image,indenter,radius_mm,depth_mm,x_mm,y_mm\n"
GOOD = "a.png,ball,4.5,2,1.5,-3\n"


def table(folder: Path, text: str | bytes) -> Path:
    cv2.imwrite(str(folder / "a.png"), np.full((6, 8), 9, np.uint8))
    path = folder / "PRESSES.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_rows_become_presses(tmp_path: Path) -> None:
    (first, second), notes = read_presses(
        table(tmp_path, HEADER + GOOD + "\n" + "a.png,ball,4.5,2e0,,\n")
    )
    assert notes == ()
    assert (first.radius_mm, first.depth_mm, first.x_mm, first.y_mm) == (4.5, 2.0, 1.5, -3.0)
    assert (second.x_mm, second.y_mm) == (None, None)
    assert first.image.shape == (6, 8)
    assert first.name == f"{tmp_path}/PRESSES.csv:2: a.png"
    assert second.name.startswith(f"{tmp_path}/PRESSES.csv:4:")


def numbers(text: str | bytes, folder: Path) -> list[tuple[float | None, ...]]:
    return [(p.radius_mm, p.depth_mm, p.x_mm, p.y_mm) for p in read_presses(table(folder, text))[0]]


def test_a_table_from_a_spreadsheet_is_read(tmp_path: Path) -> None:
    plain = HEADER + GOOD
    wanted = numbers(plain, tmp_path)
    german = plain.replace(",", ";").replace("4.5", "4,5").replace("1.5", "1,5")
    for text in (plain, german, german.replace(";", "\t"), german + ";;;;;\n"):
        rows = text.replace("\n", "\r\n")
        for encoding in ("utf-8", "utf-8-sig", "utf-16"):
            assert numbers(rows.encode(encoding), tmp_path) == wanted
    mixed = (
        "who,y_mm,x_mm,shear_x_mm,image,depth_mm,radius_mm,indenter,force_n\n"
        "me,-3,1.5,0.7,a.png,2,4.5,ball,9\n"
    )
    assert numbers(mixed, tmp_path) == wanted
    assert read_presses(tmp_path / "PRESSES.csv")[1] == (
        f"{tmp_path}/PRESSES.csv: ignoring unknown columns: who, force_n",
    )
    quoted = 'a.png,ball,"4,5",2,,\n'
    assert numbers(HEADER + quoted, tmp_path) == [(4.5, 2.0, None, None)]
    with pytest.raises(ConfigError, match="3: radius_mm: found '4,5', expected a number"):
        read_presses(table(tmp_path, HEADER + GOOD + quoted))


def test_a_named_indenter(tmp_path: Path) -> None:
    flat = cylinder("flat", 4.0)
    header = HEADER.strip() + ",yaw_deg,tilt_x_deg,tilt_y_deg,shear_x_mm,shear_y_mm\n"
    rows = "a.png,flat,,2,1.5,-3,30,-4,5.5,1,\na.png,small,,2,,,,,,,\n"
    (solid, small), _ = read_presses(table(tmp_path, header + rows), {"flat": flat, "small": 3.0})
    assert solid.indenter is flat
    assert (solid.yaw_deg, solid.tilt_x_deg, solid.tilt_y_deg) == (30.0, -4.0, 5.5)
    assert (small.indenter, small.radius_mm, small.x_mm) == (None, 3.0, None)
    for row, said in {
        "a.png,flat,,2,,,0,0,0,0,0": (
            "x_mm, y_mm: found no values, expected both values; only a ball press may omit them"
        ),
        "a.png,cube,,2,0,0,0,0,0,0,0": (
            "indenter: found 'cube', expected ball or one of INDENTERS.yaml: flat, small"
        ),
        "a.png,flat,,2,0,0,0,61,0,0,0": "tilt_x_deg: found '61', expected a number from -60 to 60",
        "a.png,flat,,2,0,0,0,0,0,nan,0": "shear_x_mm: found 'nan', expected a number",
    }.items():
        with pytest.raises(ConfigError, match=":2: ") as refusal:
            read_presses(table(tmp_path, header + row + "\n"), {"flat": flat, "small": 3.0})
        assert str(refusal.value).endswith(f"PRESSES.csv:2: {said}")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", r"PRESSES\.csv:1: found no header, expected image,indenter"),
        (
            HEADER.replace("y_mm", "x_mm") + GOOD,
            ":1: found the header .*, expected image,.*; the header lacks y_mm",
        ),
        (
            HEADER.strip() + ",x_mm\n" + GOOD,
            ":1: x_mm: found 2 columns with this name, expected one",
        ),
        (HEADER + GOOD + "a.png,ball,4.5,2,1,2,3\n", ":3: found 7 columns, expected 6"),
        (HEADER + "a.png,cube,4.5,2,,\n", ":2: indenter: found 'cube', expected ball"),
        (HEADER + "a.png,ball,big,2,,\n", ":2: radius_mm: found 'big', expected a number"),
        (HEADER + "a.png,ball,4.5,nan,,\n", ":2: depth_mm: found 'nan', expected a number"),
        (
            HEADER + "a.png,ball,4.5,2,1,\n",
            ":2: x_mm, y_mm: found only one value, expected both or neither",
        ),
        (HEADER + "none.png,ball,4.5,2,,\n", r":2: image: .*none\.png: No such file"),
        (HEADER.encode() + b"\xff\xfe\n", "not a CSV file"),
        (HEADER + '"a.png,ball\n', "not a CSV file"),
        (HEADER.encode() + b"a\0.png,ball,4.5,2,,\n", ":2: image: .*embedded null"),
    ],
)
def test_a_wrong_table_is_named_by_line_and_column(
    tmp_path: Path, text: str | bytes, said: str
) -> None:
    with pytest.raises(ConfigError, match=said) as refusal:
        read_presses(table(tmp_path, text))
    assert "\n" not in str(refusal.value)
    assert "PRESSES.csv" in str(refusal.value)


def test_what_is_captured_is_never_more_than_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tables, "ROWS_MAX", 3)
    labels, capture = LabelFolder(tmp_path), CaptureFolder(tmp_path)
    rows = [LabelRow("a.png", {"depth_mm": float(k)}, "1") for k in range(4)]
    labels.write(rows[:3])
    with pytest.raises(DeviceError, match=r"LABELS\.csv: found 4 rows, expected at most 3; those"):
        labels.write(rows)
    assert len(read_labels(labels.table, tmp_path)) == 3
    for _ in range(3):
        capture.add(capture.taken(), IMAGE, press())
    with pytest.raises(DeviceError, match=r"PRESSES\.csv: found 4 rows"):
        capture.add(capture.taken(), IMAGE, press())
    assert len(capture.taken()) == len(list(tmp_path.glob("press_*.png"))) == 3
