from __future__ import annotations

from pathlib import Path

import pytest

from tools.ci.house import Room, room_of, rooms, table


@pytest.mark.parametrize(
    ("module", "room"),
    [
        (("errors",), "errors"),
        (("daemon", "app"), "daemon"),
        (("core", "reconstruct"), "core"),
        (("core", "depth", "sigma"), "core.depth"),
        (("simulator", "skin"), "simulator"),
    ],
)
def test_a_room_is_a_folder_or_a_module(module: tuple[str, ...], room: str) -> None:
    assert room_of(module) == room


def test_sizes_and_imports_are_counted(tmp_path: Path) -> None:
    package = tmp_path / "tacshade_edge"
    (package / "core" / "depth").mkdir(parents=True)
    (package / "errors.py").write_text("class Mistake(Exception):\n    pass\n")
    (package / "core" / "depth" / "base.py").write_text(
        "# Why.\nimport numpy\nfrom tacshade_edge.errors import Mistake\n\n"
        "def solve():\n    return Mistake\n\ndef _own():\n    return numpy\n"
    )
    made = rooms(tmp_path)
    assert set(made) == {"errors", "core.depth"}
    depth = made["core.depth"]
    assert (depth.lines, depth.public, depth.comments, depth.longest) == (9, 1, 1, 2)
    assert depth.out == {"errors"}
    assert table(made).splitlines()[-1].startswith("| `errors` | 2 |")
    assert "| 1 | 0 | 0 |" in table(made), "one room imports it, it imports none"


def test_an_empty_room_has_no_share_of_comments() -> None:
    assert table({"empty": Room()}).endswith("| 0.0 |")
