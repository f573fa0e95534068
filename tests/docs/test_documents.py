"""Every document: its links lead somewhere, its length is a reader's, its figures are those of docs/results."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tools/**/*.md")) if path.is_file()
)
LINES_MAX = {"docs/accuracy.md": 100, "docs/speed.md": 100, "docs/glossary.md": 100}


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(text: str) -> set[str]:
    """What GitHub makes of headings."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_links_lead_somewhere(path: Path) -> None:
    broken = []
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text()):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        other = (path.parent / file).resolve() if file else path
        if not other.exists() or (anchor and anchor not in anchors(other.read_text())):
            broken.append(target)
    assert broken == []


@pytest.mark.parametrize("path", [path for path in DOCUMENTS if path.parent != ROOT / "docs/results"], ids=name)
def test_files_that_it_names_are_there(path: Path) -> None:
    """The pages of docs/results name programs as they are called in the commit at their top."""
    named = set(re.findall(r"(?:tests|tools|tacshade_edge)/[\w./-]*\w\.(?:py|json|sh)", path.read_text()))
    assert [file for file in sorted(named) if not (ROOT / file).exists()] == []


@pytest.mark.parametrize("document", LINES_MAX)
def test_it_is_short(document: str) -> None:
    assert len((ROOT / document).read_text().splitlines()) <= LINES_MAX[document]


def test_the_glossary_names_modules_that_are_there() -> None:
    text = (ROOT / "docs" / "glossary.md").read_text()
    paths = set(re.findall(r"`([a-z_0-9/]+(?:/|\.py))`", text))
    assert len(paths) > 20
    assert [path for path in sorted(paths) if not (ROOT / "tacshade_edge" / path).exists()] == []


def rows(text: str) -> set[tuple[str, ...]]:
    """Cells of every line of every table."""
    lines = re.findall(r"^\|(.+)\|$", text, re.MULTILINE)
    return {tuple(cell.strip() for cell in line.split("|")) for line in lines}


def test_the_accuracy_of_the_profiles_is_what_the_command_printed() -> None:
    """A line `| sensors | profile | ME | SD | ... |` quotes a page's lines "mean" and "worst object"."""
    quoted = [row for row in rows((ROOT / "docs" / "accuracy.md").read_text()) if row[0] in FAMILIES]
    assert len(quoted) == 8
    page = (ROOT / "docs" / "results" / "objects.md").read_text()
    for title, profile, me, me_worst, back, sd, iou, off, off_worst, missed in quoted:
        family = re.split(r"^Family ", page, flags=re.MULTILINE)[FAMILIES[title]]
        (mean,) = (row for row in rows(family) if row[:2] == ("mean", profile))
        (worst,) = (row for row in rows(family) if row[:2] == ("worst object", profile))
        expected = (mean[2], worst[2], mean[3], mean[4], mean[6], mean[7], mean[8], mean[9])
        assert (me, me_worst, back, sd, iou, off, off_worst, missed) == expected, (title, profile)


def test_how_well_errors_hold_is_what_the_command_printed() -> None:
    """A line quotes a page's lines of all frames, undragged and dragged ones."""
    quoted = [row for row in rows((ROOT / "docs" / "sigma.md").read_text()) if row[0] in FAMILIES]
    assert len(quoted) == 6
    page = (ROOT / "docs" / "results" / "sigma.md").read_text()
    for title, profile, error, sigma, covered, undragged, dragged, told, most in quoted:
        family = re.split(r"^Family ", page, flags=re.MULTILINE)[FAMILIES[title]].split("Both families")[0]
        every, free, drawn = (
            next(row for row in rows(family) if row[:2] == (what, profile))
            for what in ("all", "0 mm of drag", "2 mm of drag")
        )
        expected = (*every[4:7], free[6], drawn[6], *every[7:9])
        assert (error, sigma, covered, undragged, dragged, told, most) == expected, (title, profile)


FAMILIES = {"as trained on": 1, "another family": 2}


def test_there_is_one_way_to_get_it() -> None:
    """No index has the package: pip takes extras of the clone, and README.md alone says where that comes from."""
    texts = {name(path): path.read_text() for path in DOCUMENTS}
    assert [path for path, text in texts.items() if "REPOSITORY_URL" in text] == ["README.md"]
    assert texts["README.md"].count("REPOSITORY_URL") == 1
    assert [path for path, text in texts.items() if re.search(r"install (--force )?'?tacshade-edge\[", text)] == []
