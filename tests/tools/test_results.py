"""The program that makes pages of docs/results again, in a repository of its own."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tools import results
from tools.results import PAGES, Page

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
TEXT = "# Speed\n\nWhat a person wrote.\n\n"


def save(tree: Path, subject: str) -> None:
    author = ("-c", "user.name=someone", "-c", "user.email=someone@example.org", "-c", "commit.gpgsign=false")
    for words in (("add", "--all"), ("commit", "--quiet", "--allow-empty", "--message", subject)):
        subprocess.run(("git", *author, *words), cwd=tree, check=True, capture_output=True)


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with a solver, a program that prints a table, and a page."""
    for path, content in {
        ".gitignore": "__pycache__/\n",
        "tacshade_edge/core/solver.py": "",
        "tacshade_edge/hand.py": "",
        "tools/__init__.py": "",
        "tools/bench.py": f"print('{tmp_path}/a.npz\\n\\n| a | b |\\n|--|--:|\\n| x | 1 |\\n| y | 2 |')\n",
        "docs/speed.md": TEXT + "Made with nothing yet.\n",
    }.items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(content)
    monkeypatch.setattr(results, "ROOT", tmp_path)
    monkeypatch.setattr(results, "FOLDER", tmp_path / "docs")
    subprocess.run(("git", "init", "--quiet"), cwd=tmp_path, check=True)
    save(tmp_path, "Begin")
    return tmp_path


def test_the_commands_replace_what_they_printed_and_a_persons_text_stays(tree: Path) -> None:
    page = Page({"": "tools.bench", "Again": "tools.bench"}, r"^a$|^y ")
    for _ in range(2):
        results.write("speed", page)
    text = (tree / "docs/speed.md").read_text()
    assert text.startswith(f"{TEXT}Made with `python -m tools.bench` at {results.commits_of('speed')[0]} of ")
    assert text.count("a.npz\n\n| b |\n| ---: |\n| 1 |\n") == 2
    assert text.count("## Again\n\nMade with `") == 1
    assert str(tree) not in text


def test_a_page_is_stale_when_the_core_or_its_program_changed(tree: Path) -> None:
    page = Page({"": "tools.bench"})
    (tree / "tacshade_edge/core/solver.py").write_text("0\n")
    results.write("speed", page)
    assert results.why_stale("speed", page) == "names no commit"
    save(tree, "Change the solver")
    results.write("speed", page)
    save(tree, "Write the page")
    (tree / "tacshade_edge/hand.py").write_text("1\n")
    save(tree, "Change the hand")
    assert results.why_stale("speed", page) == ""
    for path in ("tacshade_edge/core/solver.py", "tools/bench.py"):
        with (tree / path).open("a") as file:
            file.write("# other\n")
        save(tree, f"Change {path}")
        assert results.why_stale("speed", page).endswith(f"Change {path}")


def test_a_command_that_fails_and_a_busy_machine_leave_the_page(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SystemExit, match="exit code 1"):
        results.write("speed", Page({"": "tools.nothing"}))
    monkeypatch.setattr(results, "OTHER_LOAD", -1.0)
    with pytest.raises(SystemExit, match="not written"):
        results.write("speed", Page({"": "tools.bench"}, idle=True))
    assert (tree / "docs/speed.md").read_text() == TEXT + "Made with nothing yet.\n"


@pytest.mark.parametrize("name", PAGES)
def test_the_programs_of_a_page_are_there(name: str) -> None:
    assert (results.FOLDER / f"{name}.md").is_file()
    for command in PAGES[name].commands.values():
        path = results.ROOT / command.split()[0].replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file()
    assert all((results.ROOT / path).exists() for path in PAGES[name].own)
