"""Pages of docs/results: what makes them stale, what is written,
and that each is current or says that it is not.
"""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tools import fingerprint, results
from tools.results import OLDER, PAGES, Page

ROOT = results.ROOT
ARCHIVED = "$Format" not in (ROOT / "tools/release/archive_version.txt").read_text(encoding="utf-8")
WITHOUT_FINGERPRINT = {
    "objects",
    "drag",
    "sigma",
    "limits",
    "paper",
    "tradeoff",
    "image-size",
    "daemon",
    "real-frames",
    "slip",
    "servo",
    "fit",
    "third-family",
    "touch",
    "arm",
    "detection",
    "recognise",
}
"""The pages that were there before fingerprints: any other page is current."""
PROGRAM = '"""A program."""\n\n\ndef half(x):\n    """Halve."""\n    return f"{x / 2:.{1}f}" + ""\n'


@pytest.mark.parametrize("name", PAGES)
def test_a_page_is_current_or_says_that_it_is_older(name: str) -> None:
    assert results.mistake(name, PAGES[name]) == ""


def test_every_page_is_known_and_the_list_of_older_ones_does_not_grow() -> None:
    written = {path.stem for path in results.FOLDER.glob("*.md")} - {"README"}
    assert written == set(PAGES)
    assert set(OLDER) <= WITHOUT_FINGERPRINT


@pytest.mark.parametrize(
    ("text", "same"),
    [
        (PROGRAM.replace("Halve.", "Divide by two."), True),
        (PROGRAM.replace("\n\n\n", "\n\n# A comment.\n"), True),
        (PROGRAM.replace('+ ""', '+ (\n        ""\n    )'), True),
        (PROGRAM + '"""What `half` is for."""\n', True),
        (PROGRAM.replace("\n\n\n", "\n\nfrom math import pi\n\n", 1), True),
        (PROGRAM.replace("x / 2", "x / 3"), False),
        (PROGRAM.replace("{1}", "{2}"), False),
        (PROGRAM.replace('+ ""', '+ "a"'), False),
    ],
)
def test_neither_format_nor_documentation_nor_imports_change_a_tree(
    tmp_path: Path, text: str, same: bool
) -> None:
    (tmp_path / "one.py").write_text(PROGRAM)
    (tmp_path / "other.py").write_text(text)
    trees = [fingerprint.tree_of(tmp_path / name) for name in ("one.py", "other.py")]
    assert (trees[0] == trees[1]) is same


def test_what_is_edited_while_a_page_is_made_counts(tmp_path: Path) -> None:
    file = tmp_path / "one.py"
    file.write_text(PROGRAM)
    before = fingerprint.tree_of(file)
    file.write_text(PROGRAM.replace("2", "3"))
    assert fingerprint.tree_of(file) != before


def test_a_program_has_the_helpers_that_it_imports_and_no_code_that_golden_results_pin() -> None:
    found = {
        path.relative_to(ROOT).as_posix() for path in fingerprint.imported(["tools.studies.sigma"])
    }
    assert {"tools/studies/sigma.py", "tools/studies/drag.py", "tools/studies/command.py"} <= found
    assert "tacshade_edge/lab/studies/evaluate/work.py" in found
    assert not [path for path in found if path.startswith("tacshade_edge/sensor")]


def test_a_page_of_speed_has_the_code_that_a_frame_passes() -> None:
    page = Page({"": "tools.benchmarks.daemon"})
    with_code = Page(page.commands, code=("tacshade_edge/sensor",))
    assert fingerprint.changed(page.fingerprint(), with_code.fingerprint()) == "program"


def test_a_long_table_becomes_csv_whole() -> None:
    rows = [f"| {k} | {k * k} |" for k in range(results.LONG + 1)]
    table = "\n".join(["| k | square |", "| ---: | ---: |", *rows])
    (text,) = results.long_tables(f"Squares\n\n{table}\n\nthe end")
    assert text.splitlines()[:2] == ["k,square", "0,0"]
    assert len(text.splitlines()) == results.LONG + 2
    assert results.long_tables(table.rpartition("\n")[0]) == []


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Page:
    """A page below `tmp_path` whose command prints this version, written by an earlier program."""
    monkeypatch.setattr(results, "FOLDER", tmp_path)
    monkeypatch.setattr(results, "OLDER", ("new",))
    (tmp_path / "new.md").write_text(
        "# A page\n"
        "\n"
        "Of a person.\n"
        "\n"
        "Made with `python -m old` at 0123456 of 2026-01-02 on one.\n"
        "\n"
        "| a |\n"
    )
    return Page({"": "tools.release.version"})


def test_an_older_page_says_so_at_its_top(page: Page) -> None:
    assert results.mistake("new", page) == "new: run `python -m tools.results --mark`"
    results.mark("new")
    assert results.mistake("new", page) == ""
    text = results.text_of("new")
    assert text.startswith("# A page\n\n> **Older than the code.** These figures, without some")
    assert "0123456 of 2026-01-02; `python -m tools.results new` makes them again" in text
    results.mark("new")
    assert results.text_of("new") == text


def test_a_stale_page_that_is_not_listed_is_a_mistake_with_the_command(
    page: Page, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(results, "OLDER", ())
    assert results.mistake("new", page).endswith("run `python -m tools.results new`")


@pytest.mark.slow
@pytest.mark.skipif(ARCHIVED, reason="an archive has no history")
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_a_page_is_written_as_its_command_prints_it_and_is_stale_when_code_changes(
    page: Page, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "new-1.csv").write_text("of an earlier run\n")
    results.mark("new")
    results.write("new", page)
    text = results.text_of("new")
    assert text.startswith("# A page\n\nOf a person.\n\nMade with `python -m tools.release.version")
    assert "| a |" not in text
    assert not (tmp_path / "new-1.csv").exists()
    assert results.mistake("new", page).startswith("new is as new as the code: take it out")
    monkeypatch.setattr(results, "OLDER", ())
    assert results.mistake("new", page) == ""
    networks, _, rest = page.fingerprint().partition("-")
    (tmp_path / "new.md").write_text(text.replace(f"{networks}-{rest}", f"00000-{rest}"))
    assert "(changed since: networks): run" in results.mistake("new", page)
