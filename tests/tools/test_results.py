"""The program that writes docs/results, with a command that only prints its help."""

from __future__ import annotations

import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest

from tools import results
from tools.results import PAGES, Page

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
HELP = Page("Help", "What it prints.", ("tacshade-edge", "--help"))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    return tmp_path


def test_a_page_says_its_command_the_code_and_the_machine(folder: Path) -> None:
    assert not results.is_current("help")
    assert results.write("help", HELP, busy=False) == ""
    text = (folder / "help.md").read_text()
    for part in (
        "# Help",
        "`tools/results.py help`",
        "| command | `tacshade-edge --help` |",
        "| machine | ",
        "usage: ",
    ):
        assert part in text
    assert f"| code | {results.commit()} |" in text
    assert results.is_current("help")


def test_a_command_that_fails_leaves_no_page(folder: Path) -> None:
    problem = results.write("wrong", Page("", "", ("tacshade-edge", "wrong")), busy=False)
    assert problem == "tacshade-edge wrong: exit code 2"
    assert list(folder.iterdir()) == []


def test_a_bench_that_misses_its_bar_has_its_page_and_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "missing_bench.py").write_text("print('| a | b |')\nraise SystemExit(1)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert results.write("missed", Page("Missed", "", ("missing_bench",)), busy=False).endswith("exit code 1")
    text = (folder / "missed.md").read_text()
    assert "| verdict | missed: exit code 1 |" in text
    assert "| a | b |" in text


def test_a_page_of_speed_wants_a_machine_to_itself(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "OTHER_LOAD", -1.0)
    speed = Page("Speed", "", HELP.command, idle=True)
    assert "not written" in results.write("speed", speed, busy=False)
    assert list(folder.iterdir()) == []
    assert results.write("speed", speed, busy=True) == ""


def test_every_program_is_there() -> None:
    for page in PAGES.values():
        program = page.command[0]
        assert program == "tacshade-edge" or find_spec(program) is not None
