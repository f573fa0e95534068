"""The apt repository: apt itself reads it, checks its signature and fetches from it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tools.release.apt_repository import KEY_FILE, lay_out, suite_of
from tools.release.package_debian import file_name

pytestmark = pytest.mark.skipif(
    any(shutil.which(name) is None for name in ("gpg", "apt-get", "dpkg-deb")), reason="not a Debian with GnuPG"
)
KEY = "release@localhost"


@pytest.fixture
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    home = tmp_path / "gnupg"
    home.mkdir(mode=0o700)
    monkeypatch.setenv("GNUPGHOME", str(home))
    words = ("--batch", "--passphrase", "", "--quick-generate-key", KEY, "ed25519", "sign", "never")
    subprocess.run(("gpg", *words), check=True, capture_output=True)
    return KEY


def package(folder: Path, version: str, machine: str = "x86_64") -> Path:
    """A small one of that name."""
    architecture = {"x86_64": "amd64", "aarch64": "arm64"}[machine]
    made = folder / file_name(version, "3.11", machine)
    root = folder / "root"
    (root / "DEBIAN").mkdir(parents=True)
    control = f"Package: tacshade-edge\nVersion: {version}+deb12\nArchitecture: {architecture}\n"
    (root / "DEBIAN/control").write_text(f"{control}Maintainer: a <a@b>\nDescription: a\n b\n")
    subprocess.run(("dpkg-deb", "--root-owner-group", "--build", root, made), check=True, capture_output=True)
    shutil.rmtree(root)
    return made


def apt(state: Path, out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run apt of a machine of its own, whose only source is the repository."""
    for name in ("lists/partial", "cache/archives/partial", "etc/apt.conf.d"):
        (state / name).mkdir(parents=True, exist_ok=True)
    (state / "status").touch()
    source = f"deb [arch=amd64 signed-by={out / KEY_FILE}] file:{out} bookworm main\n"
    (state / "etc/sources.list").write_text(source)
    options = {
        "APT::Architecture": "amd64",
        "APT::Sandbox::User": "root",
        "Dir::Etc": state / "etc",
        "Dir::State": state,
        "Dir::State::status": state / "status",
        "Dir::Cache": state / "cache",
    }
    given = [word for name, value in options.items() for word in ("-o", f"{name}={value}")]
    (state / "none").touch()
    environment = os.environ | {"APT_CONFIG": str(state / "none")}
    return subprocess.run(("apt-get", *given, *words), env=environment, capture_output=True, text=True, check=False)


def test_apt_takes_the_newest_of_what_is_signed(tmp_path: Path, key: str) -> None:
    out, state = tmp_path / "apt", tmp_path / "state"
    lay_out([package(tmp_path, "1.0.0"), package(tmp_path, "1.0.0", "aarch64")], out, key)
    lay_out([package(tmp_path, "1.0.1")], out, key)
    done = apt(state, out, "update")
    assert done.returncode == 0, done.stderr
    assert "W:" not in done.stderr, done.stderr
    done = apt(state, out, "install", "--simulate", "tacshade-edge")
    assert "Inst tacshade-edge (1.0.1+deb12 tacshade-edge:bookworm [amd64])" in done.stdout, done.stderr
    done = apt(state, out, "install", "--simulate", "tacshade-edge=1.0.0+deb12")
    assert "Inst tacshade-edge (1.0.0+deb12" in done.stdout, done.stderr


def test_apt_refuses_what_was_changed_after_it_was_signed(tmp_path: Path, key: str) -> None:
    out = tmp_path / "apt"
    lay_out([package(tmp_path, "1.0.0")], out, key)
    for name in ("InRelease", "Release"):
        signed = out / "dists/bookworm" / name
        signed.write_text(signed.read_text().replace("Label: tacshade-edge", "Label: other"))
    done = apt(tmp_path / "state", out, "update")
    assert done.returncode != 0
    assert "signature" in done.stderr


def test_a_package_of_no_suite_is_refused(tmp_path: Path, key: str) -> None:
    odd = tmp_path / "tacshade-edge_1.0.0_amd64.deb"
    odd.touch()
    assert suite_of(odd) is None
    with pytest.raises(ValueError, match=r"tacshade-edge_1\.0\.0_amd64\.deb: found no \+deb12 or \+deb13"):
        lay_out([odd], tmp_path / "apt", key)
