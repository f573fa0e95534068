from pathlib import Path

import pytest

from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.tables.labels import read_labels

HEADER = "image,depth_mm,tilt_x_deg,tilt_y_deg,shear_x_mm,shear_y_mm\n"


def table(folder: Path, text: str) -> Path:
    path = folder / "labels.csv"
    path.write_text(text)
    return path


def test_cells_may_be_empty(tmp_path: Path) -> None:
    one, two = read_labels(table(tmp_path, HEADER + "a.png,1.5,,,-0.25,2\nb.png,,,,,\n"), tmp_path / "images")
    assert one.path == tmp_path / "images" / "a.png"
    assert one.known == {"depth_mm": 1.5, "shear_x_mm": -0.25, "shear_y_mm": 2.0}
    assert two.known == {}


def test_columns_in_any_order_as_a_spreadsheet_writes_them(tmp_path: Path) -> None:
    (one,) = read_labels(table(tmp_path, "group;force_z_n;image\np1;-2,5;a.png\n"), tmp_path)
    assert one.known == {"force_z_n": -2.5}
    assert (one.group, one.where) == ("p1", f"{tmp_path}/labels.csv:2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"labels.csv:1: found no header, expected image"),
        ("image,depth\na,1\n", r"labels.csv:1: depth: found an unknown column, expected image, group and any of"),
        ("image,group\na,1\n", r"labels.csv:1: found no quantity, expected at least one of depth_mm"),
        (HEADER, "found no rows, expected one per image"),
        (HEADER + "a.png,deep,,,,\n", r"labels.csv:2: depth_mm: found 'deep', expected a number"),
        (HEADER + "a.png,nan,,,,\n", r"labels.csv:2: depth_mm: found 'nan', expected a number"),
        (HEADER + ",1,,,,\n", r"labels.csv:2: image: found nothing, expected the name of a file in "),
        (HEADER + "a.png,1\n", r"labels.csv:2: found 2 columns, expected 6"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_labels(table(tmp_path, text), tmp_path)
