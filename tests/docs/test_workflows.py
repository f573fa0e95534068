"""What a newcomer and a tag start: hooks, public CI and the release,
whose rights and commands are here.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[2]
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def read(path: str) -> dict[Any, Any]:
    loaded = yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))
    assert isinstance(loaded, dict)
    return loaded


RELEASE = read(".github/workflows/release.yml")
JOBS: dict[str, Any] = RELEASE["jobs"]


def test_the_public_ci_runs_the_pythons_that_are_supported() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    supported = [
        int(minor) for minor in re.findall(r"Python :: 3\.(\d+)", " ".join(project["classifiers"]))
    ]
    assert project["requires-python"] == f">=3.{min(supported)},<3.{max(supported) + 1}"
    workflow = (ROOT / ".github/workflows/check.yml").read_text(encoding="utf-8")
    assert f'python: ["3.{min(supported)}", "3.{max(supported)}"]' in workflow
    assert re.findall(r"- run: make (\w+)$", workflow, re.MULTILINE) == ["check", "docs", "test"]


def test_only_a_versions_tag_publishes_and_each_job_has_its_right_alone() -> None:
    assert RELEASE[True] == {
        "push": {"tags": ["v[0-9]+.[0-9]+.[0-9]+"]}
    }  # YAML 1.1 reads `on` as true
    assert RELEASE["permissions"] == {"contents": "read"}
    assert {name: job.get("permissions", {}) for name, job in JOBS.items()} == {
        "distributions": {},
        "pypi": {"id-token": "write"},
        "debian": {},
        "image": {"contents": "read", "packages": "write"},
        "release": {"contents": "write"},
    }
    download, publish = JOBS["pypi"]["steps"]
    assert download["with"]["name"] == "distributions", "built without the right to publish"
    assert publish["with"] == {"attestations": True}
