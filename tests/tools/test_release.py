"""What is released: its version, distributions, packages, the site's links and the lock that boards install."""

from __future__ import annotations

import email
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib.util import find_spec
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version
from support.booted_machine import LOCK, fetch

from tools.release import distributions, package_debian
from tools.release.version import UNKNOWN, version, version_of

ROOT = Path(__file__).parents[2]
ADDRESS = "https://example.org/one"
needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def git(folder: Path, *words: str) -> str:
    whose = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(folder), *words]
    done = subprocess.run(command, env=os.environ | whose, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """A repository with what git's archive tells its version by."""
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


@pytest.mark.parametrize("text", ["", "v1.2", "1.2.3", "v1.2.3-rc1", "v1.2.3-4", "$Format:%(describe)$"])
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
    (copy / "PKG-INFO").write_text("Metadata-Version: 2.4\nName: tacshade-edge\nVersion: 3.2.1\n\nText\n")
    assert version(copy) == "3.2.1"
    monkeypatch.setenv("TACSHADE_EDGE_VERSION", "9.8.7")
    assert version(tmp_path) == "9.8.7"
    monkeypatch.delenv("TACSHADE_EDGE_VERSION")
    monkeypatch.setenv("PATH", "")
    assert version(tree) == UNKNOWN


@pytest.mark.slow
@needs_git
@pytest.mark.skipif(
    find_spec("uv") is None or find_spec("hatchling") is None, reason="uv or hatchling is not installed"
)
def test_every_distribution_of_a_tag(tmp_path: Path) -> None:
    tree = tmp_path / "tree"
    subprocess.run(("git", "clone", "--quiet", str(distributions.TREE), str(tree)), check=True)
    project = tree / "pyproject.toml"
    project.write_text(re.sub("(?m)^Repository = .*$", f'Repository = "{ADDRESS}"', project.read_text()))
    git(tree, "commit", "--quiet", "--all", "-m", "Release")
    git(tree, "tag", "-am", "release", "v71.2.3")
    files = distributions.build(tree, tmp_path / "out")
    assert {"tacshade_edge-71.2.3-py3-none-any.whl", "tacshade_edge-71.2.3.tar.gz"} <= {path.name for path in files}
    wheels = {path.name.partition("-")[0] for path in files if path.suffix == ".whl"}
    assert len(wheels) == len(distributions.projects(tree))
    with zipfile.ZipFile(tmp_path / "out/tacshade_edge-71.2.3-py3-none-any.whl") as wheel:
        about = email.message_from_bytes(wheel.read("tacshade_edge-71.2.3.dist-info/METADATA"))
    assert "/blob/v71.2.3/docs/" in str(about.get_payload())
    assert "](docs/" not in str(about.get_payload())
    found = subprocess.run((*distributions.TWINE[:-2], "--version"), capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip(f"built, but twine cannot be fetched here: {found.stderr.strip()[-200:]}")
    distributions.check(files)


@pytest.mark.skipif(
    any(shutil.which(name) is None for name in ("gpg", "apt-get", "dpkg-deb", "reprepro")),
    reason="not a Debian with GnuPG and reprepro",
)
def test_apt_installs_what_make_apt_signed_and_refuses_what_was_changed_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home := tmp_path / "gnupg").mkdir(mode=0o700)
    monkeypatch.setenv("GNUPGHOME", str(home))
    key = ("--batch", "--passphrase", "", "--quick-generate-key", "release@localhost", "ed25519", "sign", "never")
    subprocess.run(("gpg", *key), check=True, capture_output=True)
    for machine, architecture in (("x86_64", "amd64"), ("aarch64", "arm64")):
        (root := tmp_path / "root" / machine / "DEBIAN").mkdir(parents=True)
        control = f"Package: tacshade-edge\nVersion: 1.0.0+deb12\nArchitecture: {architecture}\nSection: science\n"
        (root / "control").write_text(f"{control}Priority: optional\nMaintainer: a <a@b>\nDescription: a\n b\n")
        made = tmp_path / package_debian.file_name("1.0.0", "3.11", machine)
        words = ("dpkg-deb", "--root-owner-group", "-Zzstd", "--build", root.parent, made)
        subprocess.run(words, check=True, capture_output=True)
    command = ("make", "apt", "KEY=release@localhost", f"DIST={tmp_path}")
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    out = tmp_path / "apt"

    def apt(name: str, *words: str) -> subprocess.CompletedProcess[str]:
        """Run apt of a machine of its own, whose only source is the repository."""
        for folder in ("lists/partial", "cache/archives/partial", "etc/apt.conf.d"):
            (tmp_path / name / folder).mkdir(parents=True, exist_ok=True)
        for file in ("status", "none"):
            (tmp_path / name / file).touch()
        source = f"deb [arch=amd64 signed-by={out}/tacshade-edge.asc] file:{out} bookworm main\n"
        (tmp_path / name / "etc/sources.list").write_text(source)
        given = ["APT::Architecture=amd64", "APT::Sandbox::User=root"]
        folders = {"Etc": "/etc", "State": "", "State::status": "/status", "Cache": "/cache"}
        given += [f"Dir::{what}={tmp_path / name}{folder}" for what, folder in folders.items()]
        options = [word for one in given for word in ("-o", one)]
        environment = os.environ | {"APT_CONFIG": str(tmp_path / name / "none")}
        command = ("apt-get", *options, *words)
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    done = apt("state", "update")
    assert done.returncode == 0, done.stderr
    assert "W:" not in done.stderr, done.stderr
    done = apt("state", "install", "--simulate", "tacshade-edge")
    assert "Inst tacshade-edge (1.0.0+deb12 tacshade-edge:bookworm [amd64])" in done.stdout, done.stderr
    for name in ("InRelease", "Release"):
        signed = out / "dists/bookworm" / name
        signed.write_text(signed.read_text().replace("Label: tacshade-edge", "Label: other"))
    done = apt("other", "update")
    assert done.returncode != 0
    assert "signature" in done.stderr


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
    found, pyproject = pinned(python), tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = pyproject["project"]
    asked = [*project["dependencies"], *project["optional-dependencies"]["dashboard"]]
    for requirement in map(Requirement, [*asked, *pyproject["build-system"]["requires"]]):
        assert requirement.specifier.contains(found[requirement.name]), requirement


def test_everything_is_a_wheel_with_its_hashes_and_on_the_bill() -> None:
    assert "\n--only-binary :all:\n" in LOCK.read_text()
    for requirement, hashes in entries():
        assert hashes, requirement
        assert all(re.fullmatch(r"sha256:[0-9a-f]{64}", one) for one in hashes)
    bill = json.loads((ROOT / "docs/reference/bill.cdx.json").read_text())
    listed = {canonicalize_name(part["name"]): part["version"] for part in bill["components"]}
    assert listed == {canonicalize_name(name): version for name, version in pinned("3.11").items()}


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the lock names, fetched once."""
    return fetch(tmp_path_factory.mktemp("wheels"))


def environment(script: Path, folder: Path, wheels: Path) -> subprocess.CompletedProcess[str]:
    pip = {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(wheels), "PIP_NO_COMPILE": "1"}
    words = os.environ | {"PYTHON": sys.executable} | pip
    return subprocess.run([script, folder], env=words, capture_output=True, text=True, check=False)


def contents(folder: Path) -> dict[str, str]:
    """Of every file but what Python compiles, which holds times."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


@pytest.mark.slow
def test_two_installations_are_the_same_to_the_byte(tmp_path: Path, wheels: Path) -> None:
    app = tmp_path / "app"
    seen = []
    for _ in range(2):
        done = environment(ROOT / "systemd/environment.sh", app, wheels)
        assert done.returncode == 0, done.stderr
        seen.append(contents(app))
        pip = (app / "bin/python", "-m", "pip")
        told = subprocess.run((*pip, "list", "--format=json"), capture_output=True, text=True, check=True)
        versions = {canonicalize_name(one["name"]): one["version"] for one in json.loads(told.stdout)}
        checked = subprocess.run((*pip, "check"), capture_output=True, text=True, check=False)
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
