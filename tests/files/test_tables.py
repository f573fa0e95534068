from __future__ import annotations

import os
import tracemalloc
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.calibration.files.indenter_file import read_indenters, write_printables
from tacshade_edge.calibration.files.labels import LabelFolder, read_labels
from tacshade_edge.calibration.files.press_table import read_plan
from tacshade_edge.calibration.indenters import Indenter
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.tables import number, read_columns
from tacshade_edge.lab.pressed_file import HEADER, PressedFile


def test_a_number_is_finite() -> None:
    assert number("t.csv:2", "x_mm", "-1e-3") == -0.001
    for text in (
        "",
        "nan",
        "inf",
        "1,5",
        "1_0",
        "0x10",
        "\u0661\u0662",
        "\uff11",
        "\u22122",
        "1e400x",
        "1'000",
    ):
        with pytest.raises(ConfigError, match=r"^t\.csv:2: x_mm: found .*, expected a number$"):
            number("t.csv:2", "x_mm", text)
    for text in ("1e300", "-1000001"):
        with pytest.raises(
            ConfigError,
            match=rf"^t\.csv:2: x_mm: found '{text}', expected a number from -1e\+06 to",
        ):
            number("t.csv:2", "x_mm", text)
    with pytest.raises(ConfigError) as refusal:
        number("t.csv:2", "x_mm", "\x1b[2J\n" * 10_000)
    assert str(refusal.value).isprintable()
    assert len(str(refusal.value)) < 400


def test_a_table_has_a_most_of_rows(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("a,b\n" + "1,2\n" * 4)
    assert len(read_columns(path, ("a", "b"), (), "numbers", rows_max=4)[0]) == 4
    with pytest.raises(ConfigError, match=r"t\.csv:5: found more than 3 rows, expected at most 3"):
        read_columns(path, ("a", "b"), (), "numbers", rows_max=3)


@pytest.mark.parametrize(
    "row", ["," * 10**6, '"' + "x" * 10**6, '"\n",' * 10**6, '"' + "\n" * 10**6]
)
def test_a_row_without_end_takes_no_memory(tmp_path: Path, row: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(f"a,b\n1,2\n{row}")
    tracemalloc.start()
    with pytest.raises(ConfigError, match=r"t\.csv:\d+: not a CSV file: "):
        read_columns(path, ("a", "b"), (), "numbers")
    assert tracemalloc.get_traced_memory()[1] < 16 << 20
    tracemalloc.stop()


def test_text_of_another_encoding_is_refused_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes("a,b\n1,2\n3,é\n".encode("latin-1"))
    with pytest.raises(ConfigError, match=r"t\.csv:3: not a CSV file: .*; save it as UTF-8$"):
        read_columns(path, ("a", "b"), (), "numbers")


def test_only_a_regular_file_is_a_table(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "t.csv")
    for path, found in (
        (tmp_path / "t.csv", "found no regular file"),
        (tmp_path / "none.csv", "No such file"),
    ):
        with pytest.raises(ConfigError, match=rf"\.csv: {found}.*, expected a CSV file of numbers"):
            read_columns(path, ("a", "b"), (), "numbers")


@pytest.mark.parametrize(
    "text",
    [
        "image ,b \n two , 1.5\n",
        '"image", "b"\n"two", "1.5"\n',
        "sep=;\nimage;b\ntwo;1,5\n",
        '"sep=;"\r\nimage;b\r\ntwo;1,5\r\n',
        "\ufeffsep=;\nimage;b\ntwo;1,5\n",
        "image,b\ntwo,1.5,\n",
        "image;b;;\ntwo;1,5;;;\n;;\n",
        'image,b\ntwo,"1,5"\n',
        ",image,b\n0,two,1.5\n",
        "Unnamed: 0.1,Unnamed: 0,image,b\n7,7,two,1.5\n",
        '"";image;b\n1;two;1,5\n',
        "image,b,index\ntwo,1.5,12\n",
        ",image,b\n,two,1.5\n",
    ],
)
def test_a_table_as_spreadsheets_and_people_write_it(tmp_path: Path, text: str) -> None:
    path = tmp_path / "t.csv"
    path.write_text(text, encoding="utf-8", newline="")
    found = read_columns(path, ("image", "b"), ("c",), "numbers")
    line = 3 if "sep" in text else 2
    assert found == ([(f"{path}:{line}", {"image": "two", "b": "1.5", "c": ""})], ())


def test_a_comma_beside_decimal_points_separates_thousands(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text('image,b\ntwo,"1,234"\nthree,1.5\n')
    rows, _ = read_columns(path, ("image", "b"), (), "numbers")
    with pytest.raises(ConfigError, match=r"2: b: found '1,234', expected a number"):
        number(rows[0][0], "b", rows[0][1]["b"])


# How R separates cells, ends the whole part of a number, and whether it leaves out the name of the
# column of row names: write.table, write.table(sep = ...), write.csv and write.csv2.
R_WAYS = [
    (" ", ".", True),
    ("\t", ".", True),
    (",", ".", True),
    (",", ".", False),
    (";", ",", False),
]


@settings(max_examples=200, deadline=None)
@given(
    way=st.sampled_from(R_WAYS),
    values=st.lists(
        st.tuples(st.sampled_from(["a.png", "b 1.png", "3.png"]), st.floats(-100, 100) | st.none()),
        min_size=1,
        max_size=5,
    ),
    first=st.integers(1, 9999),
    quoted=st.booleans(),
    numbered=st.booleans(),
)
def test_a_table_as_r_writes_it(
    way: tuple[str, str, bool],
    values: list[tuple[str, float | None]],
    first: int,
    quoted: bool,
    numbered: bool,
) -> None:
    separator, point, nameless = way
    # Without quotes, R itself cannot read blanks back.
    quoted = quoted or separator == " "
    mark = '"' if quoted else ""
    lines = [[f"{mark}image{mark}", f"{mark}b{mark}"]]
    expected = []
    for k, (image, value) in enumerate(values):
        text = "NA" if value is None else f"{value:.7g}"
        lines.append([f"{mark}{image}{mark}", text.replace(".", point)])
        expected.append({"image": image, "b": text if value is not None else "", "c": ""})
        if numbered:
            lines[-1].insert(0, f"{mark}{first + k}{mark}")
    if numbered and not nameless:
        lines[0].insert(0, f"{mark}{mark}")
    with TemporaryDirectory() as folder:
        path = Path(folder, "t.csv")
        path.write_text("".join(separator.join(cells) + "\n" for cells in lines))
        rows, unknown = read_columns(path, ("image", "b"), ("c",), "numbers")
    assert [cells for _, cells in rows] == expected
    assert unknown == ()


def test_row_names_that_are_no_numbers_are_refused_with_how_to_leave_them_out(
    tmp_path: Path,
) -> None:
    path = tmp_path / "t.csv"
    for rows in ('"x","one",1\n"y","two",2\n', "1,one,1\n1,two,2\n", "one,1,note\ntwo,2,note\n"):
        path.write_text(f"image,b\n{rows}")
        with pytest.raises(ConfigError) as refused:
            read_columns(path, ("image", "b"), (), "numbers")
        assert str(refused.value) == (
            f"{path}:2: found 3 columns, expected 2: are the first R's row names? "
            "row.names = FALSE leaves them out"
        )
    path.write_text("image,b\none,1\ntwo,2,note\n")
    with pytest.raises(ConfigError, match=r"t\.csv:3: found 3 columns, expected 2$"):
        read_columns(path, ("image", "b"), (), "numbers")


def test_a_column_of_anything_but_row_numbers_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for name, cell in (("", "1.5"), ("", "left"), ("row", "1"), ("index", "-1")):
        path.write_text(f"{name},image,b\n{cell},two,1\n")
        assert read_columns(path, ("image", "b"), (), "numbers")[1] == (name,)


LABELS_HEADER = "image,depth_mm,tilt_x_deg,tilt_y_deg,shear_x_mm,shear_y_mm\n"


def table(folder: Path, text: str) -> Path:
    path = folder / "labels.csv"
    path.write_text(text)
    return path


def test_labels_have_columns_in_any_order_and_empty_cells(tmp_path: Path) -> None:
    one, two = read_labels(
        table(tmp_path, LABELS_HEADER + "a.png,1.5,,,-0.25,2\nb.png,,,,,\n"), tmp_path / "images"
    )
    assert one.path == tmp_path / "images" / "a.png"
    assert one.known == {"depth_mm": 1.5, "shear_x_mm": -0.25, "shear_y_mm": 2.0}
    assert two.known == {}
    (one,) = read_labels(table(tmp_path, "group;force_z_n;image\np1;-2,5;a.png\n"), tmp_path)
    assert one.known == {"force_z_n": -2.5}
    assert (one.group, one.where) == ("p1", f"{tmp_path}/labels.csv:2")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "image,depth\na,1\n",
            r"labels.csv:1: depth: found an unknown column, expected image, group and any of",
        ),
        (
            "image,group\na,1\n",
            r"labels.csv:1: found no quantity, expected at least one of depth_mm",
        ),
        (LABELS_HEADER, "found no rows, expected one per image"),
        (
            LABELS_HEADER + "a.png,deep,,,,\n",
            r"labels.csv:2: depth_mm: found 'deep', expected a number",
        ),
        (
            LABELS_HEADER + ",1,,,,\n",
            r"labels.csv:2: image: found nothing, expected the name of a file in ",
        ),
    ],
)
def test_a_mistake_is_reported_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_labels(table(tmp_path, text), tmp_path)


@pytest.mark.parametrize("name", ["../a.png", "/dev/zero", "~/a.png", "none.png", "a\0.png"])
def test_an_earlier_run_has_its_images_in_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    folder = LabelFolder(tmp_path / "labels")
    for place in (tmp_path, tmp_path / "labels"):
        place.mkdir(exist_ok=True)
        (place / "a.png").touch()
    folder.table.write_text("image,depth_mm\na.png,1\n./a.png,2\n")
    assert [row.image for row in folder.rows()] == ["a.png", "a.png"]
    folder.table.write_text(f"image,depth_mm\n{name},1\n")
    with pytest.raises(ConfigError, match=r"LABELS\.csv:2: image: found no file"):
        folder.rows()


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
    path.write_text(
        "indenter,radius_mm,depth_mm,x_mm,y_mm,yaw_deg\ncube,,1,0,0,30\nball,6,1,0,0,\n"
    )
    assert [press.rotation_deg for press in PressedFile(path).at(0)] == [30, 0]
    replace(path)
    assert script.at(3) == ()


@pytest.mark.parametrize(
    "row", ["ball,six,1,0,0", "egg,,1,0,0", "cube,3,1,0,0", "ball,-1,1,0,0", "ball,6,1"]
)
def test_what_cannot_be_understood_is_reported_once(tmp_path: Path, row: str) -> None:
    path = tmp_path / "hand.csv"
    script = PressedFile(path)
    replace(path, row)
    with pytest.raises(DecodeError):
        script.at(0)
    assert script.at(1) == ()


STL = "solid\nfacet\nvertex 0 0 3\nvertex 4 0 3\nvertex 0 4 5\nendfacet\nendsolid\n"
ALL = """
small: {shape: ball, radius_mm: 3}
flat: {shape: cylinder, radius_mm: 4, length_mm: 20}
square:
  shape: box
  length_mm: 6
  width_mm: 5.5
rod: {shape: bar, radius_mm: 2, length_mm: 14}
tip: {shape: cone, angle_deg: 90}
own: {shape: mesh, file: own.stl}
"""


def written(folder: Path, text: str) -> Path:
    (folder / "own.stl").write_text(STL)
    path = folder / "INDENTERS.yaml"
    path.write_text(text)
    return path


def test_every_shape(tmp_path: Path) -> None:
    found = read_indenters(written(tmp_path, ALL))
    assert list(found) == ["small", "flat", "square", "rod", "tip", "own"]
    assert found["small"] == 3.0
    for name in list(found)[1:]:
        indenter = found[name]
        assert isinstance(indenter, Indenter)
        assert indenter.name == name
        assert indenter.triangles_mm[..., 2].min() == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("- a\n", ":1: found a list, expected indenter names"),
        ("a: ball\n", ":1: a: found ball, expected a mapping"),
        (
            "a: {shape: sphere}\n",
            ":1: a.shape: found sphere, expected one of ball, bar, box, cone, cylinder, mesh",
        ),
        (
            "a:\n  shape: box\n  size_mm: 3\n",
            ":3: a.size_mm: found an unknown key, expected one of shape, radius_mm",
        ),
        (
            "a: {shape: box, length_mm: 3}\n",
            ":1: a.width_mm: found nothing, expected a value for shape box",
        ),
        (
            "a: {shape: ball, radius_mm: -3}\n",
            ":1: a.radius_mm: found -3, expected a number above 0",
        ),
        (
            "a: {shape: cone, angle_deg: 180}\n",
            ":1: a.angle_deg: found 180, expected a number above 0 to 175",
        ),
        (
            "ball: {shape: ball, radius_mm: 3}\n",
            ":1: ball: found an entry, expected none, because this name is built in",
        ),
        ("a: {shape: mesh, file: none.stl}\n", r":1: a.file: .*none.stl: No such file"),
        (
            "a: {shape: mesh, file: INDENTERS.yaml}\n",
            ":1: a.file: .* neither an ASCII nor a binary STL file",
        ),
    ],
)
def test_a_wrong_file_is_named_by_line_and_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refusal:
        read_indenters(written(tmp_path, text))
    assert "\n" not in str(refusal.value)


def test_a_mesh_in_metres_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "own: {shape: mesh, file: own.stl}\n")
    (tmp_path / "own.stl").write_text(
        STL.replace("4", "0.004").replace("3", "0.003").replace("5", "0.005")
    )
    with pytest.raises(
        ConfigError,
        match=r":1: own\.file: .*a largest dimension of 0.004 mm, expected 0.5 to 500 mm",
    ):
        read_indenters(path)


def test_those_to_print_come_with_their_table_and_replace_none(tmp_path: Path) -> None:
    written = write_printables(tmp_path / "print")
    *solids, table, plan = written
    known = read_indenters(table)
    assert [f"{name}.stl" for name in known] == [path.name for path in solids]
    assert known["ball_6"] == 6.0
    assert len(read_plan(plan, tuple(known), 20.0)) == 5 * len(known)
    with pytest.raises(
        ConfigError, match=r"INDENTERS.yaml: already exists; this command does not replace"
    ):
        write_printables(tmp_path / "print")
