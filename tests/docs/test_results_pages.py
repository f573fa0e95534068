"""The pages of docs/results: each names a commit of this history, none a path of the machine that made it."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from tools import results

ROOT = Path(__file__).parents[2]
PAGES = sorted(path.stem for path in (ROOT / "docs" / "results").glob("*.md") if path.stem != "README")
TEXTS = sorted(
    path
    for path in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("tools/**/*.md"))
    if not {".venv", ".rig"} & set(path.relative_to(ROOT).parts)
)
ARCHIVED = "$Format" not in (ROOT / "tools/release/archive_version.txt").read_text(encoding="utf-8")
"""git fills the file in when it makes an archive, which has no history. Any other tree without one fails."""
OF_A_MACHINE = re.compile(r"(?<![\w.>)~/])/(?:home|root|tmp|work|mnt|Users)/(?!printer\b)[\w.-]+")
"""`/tmp/printer` is where Klipper's own documentation has its port."""


@pytest.mark.skipif(ARCHIVED, reason="an archive has no history")
@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
@pytest.mark.parametrize("name", PAGES)
def test_a_page_names_commits_of_the_history(name: str) -> None:
    named = results.commits_of(name)
    assert named, f"docs/results/{name}.md names no commit, or one with changes that were not committed"
    for commit in named:
        results.git("merge-base", "--is-ancestor", commit, "HEAD")


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_text_has_a_path_of_a_machine(path: Path) -> None:
    assert OF_A_MACHINE.findall(path.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize("line", ["/tmp/w/ci3/.rig/a.deb: 131 MB", "at /root/x", "`/home/me/a.npz`", "(/mnt/tree)"])
def test_a_path_of_a_machine_is_seen(line: str) -> None:
    assert OF_A_MACHINE.search(line)
