from __future__ import annotations

import ast
from pathlib import Path

import pytest

from tools.ci.house import (
    PACKAGE,
    ROOT,
    Room,
    homeless_helpers,
    modules_of,
    names_twice,
    room_of,
    rooms,
    strangers,
    table,
)

OPEN_THE_LABORATORY = {
    ("__init__.py", "lab.mjcf.mujoco_sensor.MujocoSensor"),
    ("__init__.py", "lab.mjcf.mujoco_stream.MujocoStream"),
    ("camera/simulated_frames.py", "lab.pressed_file.PressedFile"),
    ("camera/simulated_frames.py", "lab.simulated_source.SimulatedSource"),
}
"""Sources of the settings, each inside the function that makes it, and names of the library, which
it imports when they are used.
"""


@pytest.mark.parametrize(
    ("module", "room"),
    [
        (("errors",), "errors"),
        (("daemon", "app"), "daemon"),
        (("sensor", "reconstruct"), "sensor"),
        (("sensor", "depth", "sigma"), "sensor.depth"),
        (("robot", "pose"), "robot"),
    ],
)
def test_a_room_is_a_folder_or_a_module(module: tuple[str, ...], room: str) -> None:
    assert room_of(module) == room


def test_sizes_and_imports_are_counted(tmp_path: Path) -> None:
    package = tmp_path / "tacshade_edge"
    (package / "sensor" / "depth").mkdir(parents=True)
    (package / "errors.py").write_text("class Mistake(Exception):\n    pass\n")
    (package / "sensor" / "depth" / "base.py").write_text(
        "# Why.\nimport numpy\nfrom tacshade_edge.errors import Mistake\n\n"
        "def solve():\n    return Mistake\n\ndef _own():\n    return numpy\n"
    )
    made = rooms(tmp_path)
    assert set(made) == {"errors", "sensor.depth"}
    depth = made["sensor.depth"]
    assert (depth.lines, depth.public, depth.comments, depth.longest) == (9, 1, 1, 2)
    assert depth.out == {"errors"}
    assert "\n| `errors` | 2 |" in table(made)
    assert "| 1 | 0 | 0 |" in table(made), "one room imports it, it imports none"


def test_an_empty_room_has_no_share_of_comments() -> None:
    assert table({"empty": Room()}).endswith("| 0.0 |")


def test_rooms_use_of_each_other_what_is_named() -> None:
    assert strangers() == []


def test_a_module_that_no_room_names_is_a_stranger(tmp_path: Path) -> None:
    package = tmp_path / "tacshade_edge"
    for room in ("one", "other"):
        (package / room).mkdir(parents=True)
    (package / "__init__.py").write_text("")
    (package / "one" / "__init__.py").write_text('"""A room.\n\nOther rooms use: `gone`.\n"""\n')
    (package / "one" / "own.py").write_text("VALUE = 1\n")
    (package / "other" / "__init__.py").write_text("from tacshade_edge.one.own import VALUE\n")
    assert strangers(tmp_path) == [
        "one.gone: no other room uses it",
        "one.own: not in the docstring of one",
    ]


def test_no_two_modules_and_no_two_classes_have_one_name() -> None:
    assert names_twice() == []


def test_two_of_one_name_are_found(tmp_path: Path) -> None:
    for room in ("one", "other"):
        (tmp_path / "tacshade_edge" / room).mkdir(parents=True)
        (tmp_path / "tacshade_edge" / room / "own.py").write_text("class Same:\n    pass\n")
    assert names_twice(tmp_path) == [
        "module own: one.own, other.own",
        "class Same: one.own, other.own",
    ]


def test_tests_take_helpers_from_support_alone() -> None:
    assert homeless_helpers() == []


def test_a_helper_of_another_test_or_of_a_tool_is_homeless(tmp_path: Path) -> None:
    for file, text in {
        "lab/test_drag.py": "from support.patience import patience\nfrom tools import results\n",
        "lab/test_sigma.py": "from tests.lab.test_drag import read\nimport tools.resultshop\n",
        "tools/test_house.py": "from tools.ci import house\n",
    }.items():
        (tmp_path / "tests" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / file).write_text(text)
    assert homeless_helpers(tmp_path) == [
        "tests/lab/test_sigma.py: tests.lab.test_drag.read",
        "tests/lab/test_sigma.py: tools.resultshop",
    ]


@pytest.mark.slow  # it parses the whole package
def test_only_commands_two_sources_and_a_public_name_open_the_laboratory() -> None:
    found = {
        (path.relative_to(ROOT / PACKAGE).as_posix(), ".".join(module))
        for path in (ROOT / PACKAGE).rglob("*.py")
        if path.relative_to(ROOT / PACKAGE).parts[0] not in ("cli", "lab")
        for module in modules_of(ast.parse(path.read_text(encoding="utf-8")))
        if module[0] == "lab"
    }
    assert found == OPEN_THE_LABORATORY
