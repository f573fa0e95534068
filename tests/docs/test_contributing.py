"""What a newcomer is given: hooks that run what `make lint` runs, and files that the forge can read."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def read(path: str) -> dict[str, object]:
    loaded = yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))
    assert isinstance(loaded, dict)
    return loaded


def test_the_hooks_run_what_make_lint_runs() -> None:
    (recipe,) = re.findall(r"^lint:.*\n((?:\t.+\n)+)", MAKEFILE, re.MULTILINE)
    wanted = [line.strip().removesuffix(" .") for line in recipe.splitlines()]
    (local,) = read(".pre-commit-config.yaml")["repos"]  # type: ignore[misc]
    assert [hook["entry"].removesuffix(" --force-exclude") for hook in local["hooks"]] == wanted


def test_the_public_ci_runs_the_pythons_that_are_supported() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    supported = [int(minor) for minor in re.findall(r"Python :: 3\.(\d+)", " ".join(project["classifiers"]))]
    assert project["requires-python"] == f">=3.{min(supported)},<3.{max(supported) + 1}"
    workflow = (ROOT / ".github/workflows/check.yml").read_text(encoding="utf-8")
    assert f'python: ["3.{min(supported)}", "3.{max(supported)}"]' in workflow
    steps = re.findall(r"- run: make (\w+)$", workflow, re.MULTILINE)
    assert steps == ["check", "docs", "test"]
    assert all(re.search(rf"^{step}:", MAKEFILE, re.MULTILINE) for step in steps)


@pytest.mark.parametrize("path", sorted(str(path.relative_to(ROOT)) for path in ROOT.glob(".github/**/*.yml")))
def test_the_forge_can_read_it(path: str) -> None:
    assert read(path)


def test_the_paper_is_cited() -> None:
    cited = read("CITATION.cff")
    (paper,) = cited["references"]  # type: ignore[misc]
    title = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert paper["title"] in title
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
