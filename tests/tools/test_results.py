"""The program that makes pages of docs/results again, in a repository of its own."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from tools import results
from tools.results import PAGES, Page

TEXT = "# Speed\n\nWhat a person wrote.\n\n"
PRINTS = "print('| a | b |\\n|--|--:|\\n| x | 1 |\\n| y | 2 |')\n"


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_a_page_is_written_and_goes_stale(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(results, "ROOT", tmp_path)
    monkeypatch.setattr(results, "FOLDER", tmp_path / "docs")
    solver, text = tmp_path / "tacshade_edge/core/solver.py", tmp_path / "docs/speed.md"
    for path, content in {
        tmp_path / ".gitignore": "__pycache__/\n",
        tmp_path / "tools/__init__.py": "",
        tmp_path / "tools/bench.py": PRINTS,
        solver: "",
        text: TEXT + "Made with nothing yet.\n",
    }.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)

    def save(subject: str) -> None:
        author = ("-c", "user.name=someone", "-c", "user.email=someone@example.org", "-c", "commit.gpgsign=false")
        for words in (("init",), ("add", "--all"), ("commit", "--message", subject)):
            subprocess.run(("git", *author, *words), cwd=tmp_path, check=True, capture_output=True)

    save("Begin")
    page = Page({"": "tools.bench", "Again": "tools.bench"}, r"^a$|^y ")
    with pytest.raises(SystemExit, match="exit code 1"):
        results.write("speed", Page({"": "tools.nothing"}))
    monkeypatch.setattr(results, "OTHER_LOAD", -1.0)
    with pytest.raises(SystemExit, match="not written"):
        results.write("speed", Page({"": "tools.bench"}, idle=True))
    assert text.read_text() == TEXT + "Made with nothing yet.\n"
    assert results.why_stale("speed", page) == "names no commit"
    results.write("speed", page)
    results.write("speed", page)
    made = f"Made with `python -m tools.bench` at {results.commits_of('speed')[0]} of "
    assert text.read_text().startswith(TEXT + made)
    assert text.read_text().count("\n\n| b |\n| ---: |\n| 1 |\n") == 2
    assert text.read_text().count("## Again\n\nMade with `") == 1
    save("Write the page")
    assert results.why_stale("speed", page) == ""
    solver.write_text("0\n")
    save("Change the solver")
    assert results.why_stale("speed", page).endswith("Change the solver")


@pytest.mark.parametrize("name", PAGES)
def test_the_programs_of_a_page_are_there(name: str) -> None:
    assert (results.FOLDER / f"{name}.md").is_file()
    for command in PAGES[name].commands.values():
        path = results.ROOT / command.split()[0].replace(".", "/")
        assert path.is_dir() or path.with_suffix(".py").is_file()
    assert all((results.ROOT / path).exists() for path in PAGES[name].own)
