"""What boards are given: the lock keeps to pyproject, the bill to the lock, and an installation to both."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from support.locked_wheels import LOCK, fetch

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def entries() -> list[tuple[Requirement, list[str]]]:
    """What is pinned, with its hashes."""
    text = LOCK.read_text().replace("\\\n", " ")
    lines = [line for line in text.splitlines() if line and not line.startswith(("#", "--only-binary"))]
    return [(Requirement(line.partition(" --hash")[0]), re.findall(r"--hash=(\S+)", line)) for line in lines]


def pinned(python: str) -> dict[str, str]:
    """Versions by name, for one Python on a board."""
    told = {"python_version": python, "python_full_version": f"{python}.7", "sys_platform": "linux"}
    found: dict[str, str] = {}
    for requirement, _ in entries():
        if requirement.marker is None or requirement.marker.evaluate(told):
            assert requirement.name not in found
            (only,) = requirement.specifier
            assert only.operator == "=="
            found[requirement.name] = only.version
    return found


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_the_lock_keeps_to_pyproject(python: str) -> None:
    found = pinned(python)
    project = PROJECT["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["dashboard"]]
    for requirement in map(Requirement, [*asked, *PROJECT["build-system"]["requires"]]):
        assert requirement.specifier.contains(found[requirement.name]), requirement


def test_everything_is_a_wheel_with_its_hashes() -> None:
    assert "\n--only-binary :all:\n" in LOCK.read_text()
    for requirement, hashes in entries():
        assert hashes, requirement
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes)


def test_the_bill_is_of_the_lock() -> None:
    bill = json.loads((ROOT / "docs/reference/bill.cdx.json").read_text())
    listed = {canonicalize_name(part["name"]): part["version"] for part in bill["components"]}
    assert listed == {canonicalize_name(name): version for name, version in pinned("3.11").items()}
    assert {part["purl"].partition("/")[0] for part in bill["components"]} == {"pkg:pypi"}


def contents(folder: Path) -> dict[str, str]:
    """Of every file but what Python compiles, which holds times."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the lock names, fetched once."""
    return fetch(tmp_path_factory.mktemp("wheels"))


def environment(script: Path, folder: Path, wheels: Path) -> subprocess.CompletedProcess[str]:
    words = os.environ | {"PYTHON": sys.executable, "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(wheels)}
    return subprocess.run([script, folder], env=words, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_two_installations_are_the_same_to_the_byte(tmp_path: Path, wheels: Path) -> None:
    app = tmp_path / "app"
    seen = []
    for _ in range(2):
        done = environment(ROOT / "systemd/environment.sh", app, wheels)
        assert done.returncode == 0, done.stderr
        seen.append(contents(app))
        listed = subprocess.run(
            [app / "bin/python", "-m", "pip", "list", "--format=json"], capture_output=True, text=True, check=True
        )
        versions = {canonicalize_name(one["name"]): one["version"] for one in json.loads(listed.stdout)}
        checked = subprocess.run(
            [app / "bin/python", "-m", "pip", "check"], capture_output=True, text=True, check=False
        )
        assert checked.returncode == 0, checked.stdout
        shutil.rmtree(app)
    assert seen[0] == seen[1]
    expected = pinned(".".join(map(str, sys.version_info[:2])))
    assert {name: versions[canonicalize_name(name)] for name in expected} == expected
    assert set(versions) - set(expected) <= {"pip", "setuptools", "tacshade-edge"}


@pytest.mark.slow
def test_another_wheel_than_the_locked_one_is_refused(tmp_path: Path, wheels: Path) -> None:
    (tmp_path / "systemd").mkdir()
    script = shutil.copy(ROOT / "systemd/environment.sh", tmp_path / "systemd")
    text = re.search(r"^flatbuffers==\S+ ", LOCK.read_text(), re.MULTILINE)
    assert text is not None
    (tmp_path / "systemd/requirements.lock").write_text(f"--only-binary :all:\n{text[0]}--hash=sha256:{'0' * 64}\n")
    done = environment(Path(script), tmp_path / "app", wheels)
    assert done.returncode == 1
    assert "THESE PACKAGES DO NOT MATCH THE HASHES" in done.stderr
    assert done.stderr.endswith("environment.sh: pip failed\n")
