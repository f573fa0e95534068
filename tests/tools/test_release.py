"""What is released: its version, its distributions and the lock that boards install."""

from __future__ import annotations

import email
import os
import re
import shutil
import subprocess
import tomllib
import venv
import zipfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from support.booted_machine import LOCK
from support.calibrated_sensor import calibrated, pressed
from support.patience import patience
from tacshade_edge.calibration.files import calibration_file
from tools.release import bill, distributions, package_debian
from tools.release.version import UNKNOWN, version, version_of

ROOT = Path(__file__).parents[2]
ADDRESS = "https://example.org/one"
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def git(folder: Path, *words: str) -> str:
    whose = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(folder), *words]
    done = subprocess.run(
        command, env=os.environ | whose, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A repository whose git archive states its version."""
    made = tmp_path / "tree"
    (made / "tools/release").mkdir(parents=True)
    for name in (".gitattributes", "tools/release/archive_version.txt"):
        shutil.copy(ROOT / name, made / name)
    git(made, "init", "-q")
    git(made, "add", ".")
    git(made, "commit", "-qm", "one")
    return made


def test_what_follows_a_tag_lies_between_it_and_the_next() -> None:
    at, later = Version(version_of("v1.2.3-0-gabc1234")), Version(version_of("v1.2.3-7-gabc1234"))
    assert Version("1.2.3") == Version(version_of("v1.2.3")) == at < later < Version("1.2.4")


@pytest.mark.parametrize(
    "text", ["", "v1.2", "1.2.3", "v1.2.3-rc1", "v1.2.3-4", "$Format:%(describe)$"]
)
def test_what_is_no_release_is_unknown(text: str) -> None:
    assert version_of(text) == UNKNOWN
    assert Version(UNKNOWN) < Version("0.0.1")


@needs_git
def test_the_version_of_a_tree_of_its_archives_and_of_what_is_neither(
    tree: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert Version(version(tree)).dev == 1
    git(tree, "tag", "wip-final")
    assert Version(version(tree)) < Version("0.1.0")
    git(tree, "tag", "-am", "release", "v1.2.3")
    git(tree, "tag", "v1.3.0-rc1")
    assert version(tree) == "1.2.3"
    if os.geteuid() == 0:  # a clone of another user
        subprocess.run(["chown", "-R", "65534", tree], check=True)
        assert version(tree) == "1.2.3"
        subprocess.run(["chown", "-R", "0", tree], check=True)
    for name in ("tagged", "later"):
        git(tree, "archive", "--format=tar", f"--output={tmp_path / name}.tar", "HEAD")
        shutil.unpack_archive(tmp_path / f"{name}.tar", tmp_path / name)
        git(tree, "commit", "-qm", "two", "--allow-empty")
    assert version(tmp_path / "tagged") == "1.2.3"
    assert Version(version(tmp_path / "later")).public == "1.2.4.dev1"
    (copy := tree / "copy").mkdir()
    assert version(copy) == UNKNOWN, "a copy within another repository"
    (copy / "PKG-INFO").write_text(
        "Metadata-Version: 2.4\nName: tacshade-edge\nVersion: 3.2.1\n\nText\n"
    )
    assert version(copy) == "3.2.1"
    monkeypatch.setenv("TACSHADE_EDGE_VERSION", "9.8.7")
    assert version(tmp_path) == "9.8.7"
    monkeypatch.delenv("TACSHADE_EDGE_VERSION")
    monkeypatch.setenv("PATH", "")
    assert version(tree) == UNKNOWN


def run(*words: str | Path, cwd: Path) -> str:
    """Run a command outside any checkout's environment; return its output."""
    clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    done = subprocess.run(
        words,
        cwd=cwd,
        env=clean,
        capture_output=True,
        text=True,
        timeout=patience(120),
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
@needs_git
@pytest.mark.skipif(
    any(find_spec(name) is None for name in ("uv", "hatchling", "pip")),
    reason="needs uv, hatchling, pip",
)
def test_every_distribution_of_a_tag_and_the_wheel_works_out_of_any_checkout(
    tmp_path: Path,
) -> None:
    tree, out = tmp_path / "tree", tmp_path / "out"
    subprocess.run(("git", "clone", "--quiet", str(distributions.TREE), str(tree)), check=True)
    project = tree / "pyproject.toml"
    with pytest.raises(ValueError, match="found none, expected an address"):
        distributions.repository(tree)
    with project.open("a") as file:
        file.write(f'[project.urls]\nRepository = "{ADDRESS}"\n')
    git(tree, "commit", "--quiet", "--all", "-m", "Release")
    git(tree, "tag", "-am", "release", "v71.2.3")
    files = distributions.build(tree, out)
    wheel = out / "tacshade_edge-71.2.3-py3-none-any.whl"
    assert {wheel.name, "tacshade_edge-71.2.3.tar.gz"} <= {path.name for path in files}
    wheels = {path.name.partition("-")[0] for path in files if path.suffix == ".whl"}
    assert len(wheels) == len(distributions.projects(tree))
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        about = email.message_from_bytes(archive.read("tacshade_edge-71.2.3.dist-info/METADATA"))
    assert {"tacshade_edge/py.typed", "tacshade_edge/sensor/inference/weights/fast.onnx"} <= set(
        names
    )
    assert {name.split("/")[0].split("-")[0] for name in names} == {"tacshade_edge"}
    assert "/blob/v71.2.3/docs/" in str(about.get_payload())
    assert "](docs/" not in str(about.get_payload())

    # In an environment that sees this one's packages:
    # nothing is downloaded, and what this one has installed stays.
    venv.create(tmp_path / "environment", symlinks=True)
    python = tmp_path / "environment/bin/python"
    packages = run(
        python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=tmp_path
    ).strip()
    Path(packages, "others.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    words = (
        "install",
        "--quiet",
        "--no-index",
        "--no-deps",
        "--ignore-installed",
        "--disable-pip-version-check",
    )
    run(python, "-m", "pip", *words, wheel, cwd=tmp_path)
    command = python.with_name("tacshade-edge")
    assert run(command, "--version", cwd=tmp_path) == "tacshade-edge 71.2.3\n"
    calibration_file.save(tmp_path / "cal.npz", calibrated())
    cv2.imwrite(str(tmp_path / "press.png"), pressed("ball", 2.0).image)
    run(
        command,
        "reconstruct",
        "--calibration",
        "cal.npz",
        "--out",
        "result",
        "press.png",
        cwd=tmp_path,
    )
    with np.load(tmp_path / "result/press.npz") as result:
        assert np.nanmax(result["height_mm"]) == pytest.approx(2.0, rel=0.2)


def entries() -> list[tuple[Requirement, list[str]]]:
    """What is pinned, with its hashes."""
    text = LOCK.read_text().replace("\\\n", " ")
    lines = [
        line for line in text.splitlines() if line and not line.startswith(("#", "--only-binary"))
    ]
    return [
        (Requirement(line.partition(" --hash")[0]), re.findall(r"--hash=(\S+)", line))
        for line in lines
    ]


def pinned(python: str) -> dict[str, str]:
    """Versions by name, for one Python on a board."""
    environment = {
        "python_version": python,
        "python_full_version": f"{python}.7",
        "sys_platform": "linux",
    }
    found: dict[str, str] = {}
    for requirement, _ in entries():
        if requirement.marker is None or requirement.marker.evaluate(environment):
            assert requirement.name not in found
            found[requirement.name] = only(requirement)
    return found


def only(requirement: Requirement) -> str:
    """The one version that a requirement permits."""
    (specifier,) = requirement.specifier
    assert specifier.operator == "=="
    return specifier.version


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13", "3.14"])
def test_the_lock_keeps_to_pyproject(python: str) -> None:
    found, pyproject = pinned(python), tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = pyproject["project"]
    extras = project["optional-dependencies"]
    asked = [*project["dependencies"], *extras["dashboard"], *extras["prometheus"]]
    for requirement in map(Requirement, [*asked, *pyproject["build-system"]["requires"]]):
        pin = found[canonicalize_name(requirement.name)]
        assert requirement.specifier.contains(pin), requirement


def listed(python: str) -> dict[str, Any]:
    """A bill of what is pinned for one Python, as ``cyclonedx-py`` writes it."""
    refs = {f"{name}=={version}": (name, version) for name, version in pinned(python).items()}
    return {
        "metadata": {"component": {"bom-ref": "root-component"}},
        "components": [
            {"bom-ref": ref, "name": name, "version": version}
            for ref, (name, version) in refs.items()
        ],
        "dependencies": [
            {"ref": "root-component", "dependsOn": sorted(refs)},
            *({"ref": ref} for ref in refs),
        ],
    }


def test_the_bill_lists_what_is_pinned_for_any_python() -> None:
    lock, supported = LOCK.read_text(), bill.pythons(ROOT)
    assert supported == ["3.11", "3.12", "3.13", "3.14"]
    assert bill.pinned(lock) == {(each.name, only(each)) for each, _ in entries()}
    one = listed("3.11")
    assert bill.missing(one, lock) == [
        f"{name} {version}"
        for name, version in sorted(bill.pinned(lock) - set(pinned("3.11").items()))
    ]
    whole = bill.joined(map(listed, supported))
    assert bill.missing(whole, lock) == []
    refs = [each["bom-ref"] for each in whole["components"]]
    assert refs == sorted(set(refs))
    needs = {each["ref"]: each.get("dependsOn") for each in whole["dependencies"]}
    assert needs == {"root-component": refs} | dict.fromkeys(refs)
    assert whole["metadata"] == one["metadata"]


def test_everything_is_a_wheel_with_its_hashes() -> None:
    assert "\n--only-binary :all:\n" in LOCK.read_text()
    for requirement, hashes in entries():
        assert hashes, requirement
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes)


@pytest.mark.slow
@pytest.mark.skipif(find_spec("shtab") is None, reason="shtab is not installed")
def test_debians_package_completes_commands(tmp_path: Path) -> None:
    package_debian.completion(tmp_path / "completions")
    script = (tmp_path / "completions" / "tacshade-edge").read_text()
    assert "complete " in script
    assert "backup" in script
