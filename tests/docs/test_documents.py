"""Every document: its links and files are there, it has a place in the site,
and its tables are the code's.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import tacshade_edge
import tacshade_edge.doctor
from tools import results
from tools.release.docs_site import expand

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
DOCUMENTS = sorted(
    path
    for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tools/**/*.md"))
    if path.is_file() and not {".venv", ".rig"} & set(path.relative_to(ROOT).parts)
)
SETTINGS = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
ARCHIVED = "$Format" not in (ROOT / "tools/release/archive_version.txt").read_text(encoding="utf-8")
"""git fills the file in when it makes an archive, which has no history.

Any other tree without one fails.
"""
OF_A_MACHINE = re.compile(r"(?<![\w.>)~/])/(?:home|root|tmp|work|mnt|Users)/[\w.-]+")


def name(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(text: str) -> set[str]:
    """What GitHub makes of headings."""
    headings = re.findall(
        r"^#+ (.+)$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE
    )
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", DOCUMENTS, ids=name)
def test_what_it_names_is_there_and_nothing_is_of_a_machine(path: Path) -> None:
    text, broken = path.read_text(), []
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        other = (path.parent / file).resolve() if file else path
        if not other.exists() or (anchor and anchor not in anchors(other.read_text())):
            broken.append(target)
    assert broken == []
    if (
        path.parent != DOCS / "results"
    ):  # these name programs as they are called in the commit at their top
        named = set(re.findall(r"(?:tests|tools|tacshade_edge)/[\w./-]*\w\.(?:py|json|sh)", text))
        assert [file for file in sorted(named) if not (ROOT / file).exists()] == []
    assert OF_A_MACHINE.findall(text) == []


def test_every_check_of_doctor_has_its_row() -> None:
    rows = set(
        re.findall(r"^\| `([a-z ]+)` \|", (DOCS / "how-to/doctor.md").read_text(), re.MULTILINE)
    )
    code = "".join(
        path.read_text() for path in Path(tacshade_edge.doctor.__file__).parent.glob("*.py")
    )
    made = set(re.findall(r'\b(?:ok|warning|fault|_failed)\(\s*"([a-z ]+)"', code)) | {
        "settings",
        "source",
        "broker round trip",
    }
    assert rows == made


@pytest.mark.skipif(ARCHIVED, reason="an archive has no history")
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
@pytest.mark.parametrize(
    "page", [path.stem for path in DOCS.glob("results/*.md") if path.stem != "README"]
)
def test_a_page_of_results_names_commits_of_the_history(page: str) -> None:
    named = results.commits_of(page)
    assert named, (
        f"docs/results/{page}.md names no commit, or one with changes that were not committed"
    )
    for commit in named:
        results.git("merge-base", "--is-ancestor", commit, "HEAD")


def leaves(nav: Any) -> Iterator[str]:
    if isinstance(nav, str):
        yield nav
    else:
        for entry in nav.values() if isinstance(nav, dict) else nav:
            yield from leaves(entry)


def test_every_page_has_one_place_in_the_site() -> None:
    pages = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.glob("**/*.md"))
    assert sorted(leaves(expand(SETTINGS["nav"]))) == pages
    checks = {
        name: check for group in SETTINGS["validation"].values() for name, check in group.items()
    }
    assert (SETTINGS["strict"], set(checks.values())) == (True, {"warn"}), (
        "what is broken fails the build"
    )
    assert {"omitted_files", "not_found", "anchors", "unrecognized_links"} <= set(checks)


@pytest.mark.slow
@pytest.mark.skipif(
    importlib.util.find_spec("mkdocs") is None, reason="mkdocs (the extra docs) is not installed"
)
def test_the_site_builds_and_lists_the_library(tmp_path: Path) -> None:
    # Not --quiet: it hides warnings from the strict build too.
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stderr
    api = (tmp_path / "reference" / "api.html").read_text(encoding="utf-8")
    listed = set(re.findall(r'<h2 id="tacshade_edge\.(\w+)"', api))
    assert listed == set(tacshade_edge.__all__) - {"__version__"}
