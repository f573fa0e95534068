"""The workflow that a tag starts: what may publish, with which rights, and that it runs what is here."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
FILE = ROOT / ".github/workflows/release.yml"
JOBS: dict[str, Any] = yaml.safe_load(FILE.read_text())["jobs"]
MAKEFILE = (ROOT / "Makefile").read_text()
SHA = re.compile(r"[\w-]+/[\w-]+@[0-9a-f]{40}")


def steps(job: str) -> list[dict[str, Any]]:
    return list(JOBS[job]["steps"])


def test_only_a_versions_tag_starts_it() -> None:
    workflow = yaml.safe_load(FILE.read_text())
    assert workflow[True] == {"push": {"tags": ["v[0-9]+.[0-9]+.[0-9]+"]}}  # YAML 1.1 reads `on` as true
    assert workflow["permissions"] == {"contents": "read"}


def test_who_publishes_has_the_right_for_that_alone() -> None:
    rights = {name: job.get("permissions", {}) for name, job in JOBS.items()}
    assert rights == {
        "distributions": {},
        "pypi": {"id-token": "write"},
        "debian": {},
        "image": {"contents": "read", "packages": "write"},
        "release": {"contents": "write"},
    }
    assert JOBS["pypi"]["environment"]["name"] == "pypi"
    assert JOBS["debian"]["environment"] == "debian"


def test_what_goes_to_pypi_is_built_without_the_right_to_publish() -> None:
    download, publish = steps("pypi")
    assert download["with"]["name"] == "distributions"
    assert SHA.fullmatch(publish["uses"])
    assert publish["with"] == {"attestations": True}
    assert "distributions" in JOBS["pypi"]["needs"]


def test_the_image_is_for_both_architectures() -> None:
    (build,) = (step for step in steps("image") if step.get("uses", "").startswith("docker/build-push-action@"))
    assert build["with"]["platforms"] == "linux/amd64,linux/arm64"
    assert (ROOT / build["with"]["file"]).is_file()
    assert build["with"]["build-args"].startswith("TACSHADE_EDGE_VERSION=")


@pytest.mark.parametrize("job", JOBS)
def test_its_commands_are_there(job: str) -> None:
    text = "\n".join(step.get("run", "") for step in steps(job))
    for target in re.findall(r"\bmake (\w+)", text):
        assert re.search(rf"^{target}:", MAKEFILE, re.MULTILINE), target
    for module in re.findall(r"-m (tools[\w.]+)", text):
        assert (ROOT / f"{module.replace('.', '/')}.py").is_file(), module


def test_every_action_names_a_version() -> None:
    used = [step["uses"] for job in JOBS for step in steps(job) if "uses" in step]
    assert [name for name in used if not re.search(r"@(v\d+|[0-9a-f]{40})$", name)] == []
