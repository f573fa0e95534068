from __future__ import annotations

from pathlib import Path

import pytest

from tacshade_edge.core.calibration.indenters import Indenter
from tacshade_edge.errors import ConfigError
from tacshade_edge.storage.tables.capture_folder import read_plan
from tacshade_edge.storage.tables.indenters import read_indenters, write_printables

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
        ("a: {shape: sphere}\n", ":1: a.shape: found sphere, expected one of ball, bar, box, cone, cylinder, mesh"),
        ("a:\n  shape: box\n  size_mm: 3\n", ":3: a.size_mm: found an unknown key, expected one of shape, radius_mm"),
        ("a:\n  radius_mm: 3\n", "a.shape: found nothing, expected one of ball"),
        ("a: {shape: cylinder}\n", ":1: a.radius_mm: found nothing, expected a value for shape cylinder"),
        ("a: {shape: box, length_mm: 3}\n", ":1: a.width_mm: found nothing, expected a value for shape box"),
        ("a: {shape: bar, radius_mm: 3}\n", ":1: a.length_mm: found nothing, expected a value for shape bar"),
        ("a: {shape: cone, radius_mm: 3}\n", ":1: a.angle_deg: found nothing, expected a value for shape cone"),
        ("a: {shape: mesh}\n", ":1: a.file: found nothing, expected a value for shape mesh"),
        ("a: {shape: ball, radius_mm: -3}\n", ":1: a.radius_mm: found -3, expected a number above 0"),
        ("a: {shape: cone, angle_deg: 180}\n", ":1: a.angle_deg: found 180, expected a number above 0 to 175"),
        (
            "ball: {shape: ball, radius_mm: 3}\n",
            ":1: ball: found an entry, expected none, because this name is built in",
        ),
        ("a: {shape: mesh, file: none.stl}\n", r":1: a.file: .*none.stl: No such file"),
        ("a: {shape: mesh, file: INDENTERS.yaml}\n", ":1: a.file: .* neither an ASCII nor a binary STL file"),
    ],
)
def test_a_wrong_file_is_told_by_line_and_key(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said) as refusal:
        read_indenters(written(tmp_path, text))
    assert "\n" not in str(refusal.value)


def test_a_mesh_in_metres_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "own: {shape: mesh, file: own.stl}\n")
    (tmp_path / "own.stl").write_text(STL.replace("4", "0.004").replace("3", "0.003").replace("5", "0.005"))
    with pytest.raises(ConfigError, match=r":1: own\.file: .*a largest dimension of 0.004 mm, expected 0.5 to 500 mm"):
        read_indenters(path)


def test_those_to_print_come_with_their_table_and_replace_none(tmp_path: Path) -> None:
    written = write_printables(tmp_path / "print")
    *solids, table, plan = written
    known = read_indenters(table)
    assert [f"{name}.stl" for name in known] == [path.name for path in solids]
    assert known["ball_6"] == 6.0
    assert len(read_plan(plan, tuple(known), 20.0)) == 5 * len(known)
    with pytest.raises(ConfigError, match=r"INDENTERS.yaml: already exists; this command does not replace"):
        write_printables(tmp_path / "print")
