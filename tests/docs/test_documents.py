"""Every document: its links lead somewhere, and the files that it names are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tools/**/*.md")) if path.is_file()
)


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


def test_there_is_one_way_to_get_it() -> None:
    """No index has the package: pip takes extras of the clone, and pyproject.toml alone says where that comes from."""
    texts = {name(path): path.read_text() for path in DOCUMENTS}
    assert [path for path, text in texts.items() if "REPOSITORY_URL" in text] == []
    assert re.findall(r"REPOSITORY_URL", (ROOT / "pyproject.toml").read_text()) == ["REPOSITORY_URL"]
    assert [path for path, text in texts.items() if re.search(r"install (--force )?'?tacshade-edge\[", text)] == []
