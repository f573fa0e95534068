"""tools/release/version.py: a version from every kind of tree that somebody builds from."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from packaging.version import Version

from tools.release.version import UNKNOWN, version, version_of

ROOT = Path(__file__).parents[3]
GIT = shutil.which("git")
needs_git = pytest.mark.skipif(GIT is None, reason="git is not installed")
numbers = st.integers(0, 999)


def git(folder: Path, *words: str) -> str:
    whose = {"GIT_CONFIG_GLOBAL": os.devnull, "GIT_CONFIG_SYSTEM": os.devnull}
    command = ["git", "-c", "user.name=a", "-c", "user.email=a@b", "-C", str(folder), *words]
    done = subprocess.run(command, env=os.environ | whose, capture_output=True, text=True, check=True)
    return done.stdout.strip()


def committed(folder: Path) -> Path:
    """A tree with what git's archive tells its version by."""
    (folder / "tools/release").mkdir(parents=True)
    for name in (".gitattributes", "tools/release/archive_version.txt"):
        shutil.copy(ROOT / name, folder / name)
    git(folder, "init", "-q")
    git(folder, "add", ".")
    git(folder, "commit", "-qm", "one")
    return folder


@given(numbers, numbers, numbers, st.integers(1, 999))
def test_what_follows_a_tag_lies_between_it_and_the_next(major: int, minor: int, patch: int, distance: int) -> None:
    tag = f"v{major}.{minor}.{patch}"
    at, later = Version(version_of(f"{tag}-0-gabc1234")), Version(version_of(f"{tag}-{distance}-gabc1234"))
    assert Version(version_of(tag)) == at == Version(tag)
    assert at < later < Version(f"{major}.{minor}.{patch + 1}")


def test_who_sends_a_part_of_the_tree_tells_its_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TACSHADE_EDGE_VERSION", "1.2.3")
    assert version(tmp_path) == "1.2.3"
    monkeypatch.setenv("TACSHADE_EDGE_VERSION", "")
    assert version(tmp_path) == UNKNOWN


@pytest.mark.parametrize("text", ["", "v1.2", "1.2.3", "v1.2.3-rc1", "v1.2.3-4", "$Format:%(describe)$"])
def test_what_is_no_release_is_unknown(text: str) -> None:
    assert version_of(text) == UNKNOWN
    assert Version(UNKNOWN) < Version("0.0.1")


@needs_git
def test_from_tags_and_before_the_first(tmp_path: Path) -> None:
    tree = committed(tmp_path)
    assert Version(version(tree)).dev == 1
    git(tree, "tag", "wip-final")
    assert Version(version(tree)) < Version("0.1.0")
    git(tree, "tag", "-am", "release", "v1.2.3")
    git(tree, "tag", "v1.3.0-rc1")
    assert version(tree) == "1.2.3"
    git(tree, "commit", "-qm", "two", "--allow-empty")
    assert version(tree) == f"1.2.4.dev1+g{git(tree, 'rev-parse', '--short', 'HEAD')}"


@needs_git
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give files away")
def test_from_a_clone_of_another_user(tmp_path: Path) -> None:
    tree = committed(tmp_path)
    git(tree, "tag", "v1.2.3")
    subprocess.run(["chown", "-R", "65534", tree], check=True)
    assert version(tree) == "1.2.3"


@needs_git
def test_from_an_archive_that_git_made(tmp_path: Path) -> None:
    (tree := tmp_path / "tree").mkdir()
    committed(tree)
    git(tree, "tag", "v1.2.3")
    for name in ("tagged", "later"):
        git(tree, "archive", "--format=tar", f"--output={tmp_path / name}.tar", "HEAD")
        shutil.unpack_archive(tmp_path / f"{name}.tar", tmp_path / name)
        git(tree, "commit", "-qm", "two", "--allow-empty")
    assert version(tmp_path / "tagged") == "1.2.3"
    assert Version(version(tmp_path / "later")).public == "1.2.4.dev1"


@needs_git
def test_a_copy_within_another_repository_has_not_its_version(tmp_path: Path) -> None:
    tree = committed(tmp_path)
    git(tree, "tag", "v1.2.3")
    (copy := tree / "copy").mkdir()
    assert version(copy) == UNKNOWN


def test_without_git_nothing_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / ".git").mkdir()
    monkeypatch.setenv("PATH", "")
    assert version(tmp_path) == UNKNOWN


def test_an_sdist_has_its_own(tmp_path: Path) -> None:
    (tmp_path / "PKG-INFO").write_text("Metadata-Version: 2.4\nName: tacshade-edge\nVersion: 1.2.3\n\nText\n")
    assert version(tmp_path) == "1.2.3"
