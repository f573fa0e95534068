"""The program that writes docs/results, with a command that only prints its help."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from tools import results
from tools.results import PAGES, Page

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
HELP = Page("Help", "What it prints.", ("tacshade-edge", "--help"), ())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    return tmp_path


def test_a_page_says_its_command_the_code_and_the_machine(folder: Path) -> None:
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
    assert results.named_commit(text) in ("", results.commit().split()[0])


def test_a_command_that_fails_leaves_no_page(folder: Path) -> None:
    problem = results.write("wrong", Page("", "", ("tacshade-edge", "wrong"), ()), busy=False)
    assert problem == "tacshade-edge wrong: exit code 2"
    assert list(folder.iterdir()) == []


def test_a_bench_that_misses_its_bar_has_its_page_and_says_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "missing_bench.py").write_text("print('| a | b |')\nraise SystemExit(1)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert results.write("missed", Page("Missed", "", ("missing_bench",), ()), busy=False).endswith("exit code 1")
    text = (folder / "missed.md").read_text()
    assert "| verdict | missed: exit code 1 |" in text
    assert "| a | b |" in text


def test_a_page_has_no_path_of_the_machine(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bench.py").write_text(f"print('{results.ROOT}/a.deb and {tempfile.gettempdir()}/maps')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert results.write("paths", Page("Paths", "", ("bench",), ()), busy=False) == ""
    assert "\na.deb and maps\n" in (folder / "paths.md").read_text()


def test_a_page_of_speed_wants_a_machine_to_itself(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "OTHER_LOAD", -1.0)
    speed = Page("Speed", "", HELP.command, (), idle=True)
    assert "not written" in results.write("speed", speed, busy=False)
    assert list(folder.iterdir()) == []
    assert results.write("speed", speed, busy=True) == ""


@pytest.mark.parametrize("name", PAGES)
def test_what_a_page_depends_on_is_there(name: str) -> None:
    assert [path for path in results.depends_on(PAGES[name]) if not (results.ROOT / path).exists()] == []


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with two rooms, a program that prints a table, and the page `speed`, which depends on one room."""
    for path in ("depth/solver.py", "hand/link.py", "tools/bench.py"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text("print('| a | b |')\n")
    (tmp_path / "tools/__init__.py").touch()
    (tmp_path / "docs").mkdir()
    monkeypatch.setattr(results, "ROOT", tmp_path)
    monkeypatch.setattr(results, "FOLDER", tmp_path / "docs")
    monkeypatch.setattr(results, "PAGES", {"speed": Page("Speed", "", ("tools.bench",), ("depth",))})
    git(tmp_path, "init", "--quiet")
    save(tmp_path, "Begin")
    return tmp_path


def git(tree: Path, *words: str) -> None:
    author = ("-c", "user.name=someone", "-c", "user.email=someone@example.org", "-c", "commit.gpgsign=false")
    subprocess.run(("git", *author, *words), cwd=tree, check=True, capture_output=True)


def save(tree: Path, subject: str) -> None:
    git(tree, "add", "--all")
    git(tree, "commit", "--quiet", "--message", subject)


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["results.py", *words])
    return results.main()


def why() -> str:
    return results.why_stale("speed", results.PAGES["speed"])


def test_a_page_is_stale_when_what_it_depends_on_changes(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert why() == "is not written"
    assert run(monkeypatch, "--stale", "--make") == 0
    save(tree, "Write the page")
    assert why() == ""

    (tree / "hand/link.py").write_text("1\n")
    save(tree, "Change the hand")
    assert why() == ""

    (tree / "depth/solver.py").write_text("2\n")
    assert why().startswith("uncommitted changes since ")
    save(tree, "Change the solver")
    assert why().startswith("commits since ")
    assert why().endswith("Change the solver")

    assert run(monkeypatch, "--stale", "--make") == 0
    assert why() == ""


def test_a_page_of_the_program_that_changed_is_stale(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "speed") == 0
    (tree / "tools/bench.py").write_text("print('| c | d |')\n")
    save(tree, "Change the bench")
    assert why().endswith("Change the bench")


def test_a_page_whose_commit_is_not_in_the_history_is_stale(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(monkeypatch, "speed") == 0
    save(tree, "Write the page")
    git(tree, "checkout", "--quiet", "--orphan", "other")
    save(tree, "Begin anew")
    assert why().endswith("which is not in the history")


def test_a_page_of_uncommitted_changes_names_no_commit(tree: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tree / "depth/solver.py").write_text("2\n")
    assert run(monkeypatch, "speed") == 0
    assert why() == "names no commit"


def test_to_list_makes_nothing(tree: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(monkeypatch, "--stale") == 0
    assert capsys.readouterr().out.split() == ["speed", "is", "not", "written"]
    assert list((tree / "docs").iterdir()) == []


def test_the_list_of_pages_says_which_are_not_written(tree: Path) -> None:
    (tree / "docs/by-hand.md").write_text("# Another\n")
    results.index()
    text = (tree / "docs/README.md").read_text()
    assert "| [Another](by-hand.md) |" in text
    assert "## Not written" in text
    assert "- `speed`, Speed:" in text
