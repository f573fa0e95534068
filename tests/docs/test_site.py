"""mkdocs.yml: every page has one place in the site, and the site builds without a warning."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

import tacshade_edge
from tools.release.docs_site import expand

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SETTINGS = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
BUILT_S = 300


def leaves(nav: Any) -> Iterator[str]:
    if isinstance(nav, str):
        yield nav
    else:
        for entry in nav.values() if isinstance(nav, dict) else nav:
            yield from leaves(entry)


def test_every_page_has_one_place() -> None:
    pages = sorted(path.relative_to(DOCS).as_posix() for path in DOCS.glob("**/*.md"))
    assert sorted(leaves(expand(SETTINGS["nav"]))) == pages


def test_whatever_is_broken_fails_the_build() -> None:
    checks = {name: check for group in SETTINGS["validation"].values() for name, check in group.items()}
    assert SETTINGS["strict"] is True
    assert set(checks.values()) == {"warn"}
    assert {"omitted_files", "not_found", "anchors", "unrecognized_links"} <= set(checks)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="mkdocs (the extra docs) is not installed")
def test_it_builds_and_lists_the_library(tmp_path: Path) -> None:
    # Not --quiet: it hides warnings from the strict build too.
    command = [sys.executable, "-m", "mkdocs", "build", "--site-dir", str(tmp_path)]
    done = subprocess.run(
        command,
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=BUILT_S,
    )
    assert done.returncode == 0, done.stderr
    api = (tmp_path / "reference" / "api.html").read_text(encoding="utf-8")
    listed = set(re.findall(r'<h2 id="tacshade_edge\.(\w+)"', api))
    assert listed == set(tacshade_edge.__all__) - {"__version__"}
    index = (tmp_path / "search" / "search_index.json").read_text(encoding="utf-8")
    assert "Calibrating a sensor" in index
