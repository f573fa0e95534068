"""`make apt`: apt itself reads the repository and checks its signature."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tools.release.package_debian import file_name

pytestmark = pytest.mark.skipif(
    any(shutil.which(name) is None for name in ("gpg", "apt-get", "dpkg-deb", "reprepro")),
    reason="not a Debian with GnuPG and reprepro",
)
TREE = Path(__file__).parents[3]
KEY = "release@localhost"


@pytest.fixture
def key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "gnupg"
    home.mkdir(mode=0o700)
    monkeypatch.setenv("GNUPGHOME", str(home))
    words = ("--batch", "--passphrase", "", "--quick-generate-key", KEY, "ed25519", "sign", "never")
    subprocess.run(("gpg", *words), check=True, capture_output=True)


def package(folder: Path, version: str, machine: str = "x86_64") -> None:
    """Make a small package of that name."""
    architecture = {"x86_64": "amd64", "aarch64": "arm64"}[machine]
    made = folder / file_name(version, "3.11", machine)
    root = folder / "root"
    (root / "DEBIAN").mkdir(parents=True)
    control = f"Package: tacshade-edge\nVersion: {version}+deb12\nArchitecture: {architecture}\n"
    control += "Section: science\nPriority: optional\n"
    (root / "DEBIAN/control").write_text(f"{control}Maintainer: a <a@b>\nDescription: a\n b\n")
    subprocess.run(("dpkg-deb", "--root-owner-group", "-Zzstd", "--build", root, made), check=True, capture_output=True)
    shutil.rmtree(root)


def lay_out(dist: Path) -> Path:
    """Run `make apt` on a folder of packages; return the repository."""
    subprocess.run(("make", "apt", f"KEY={KEY}", f"DIST={dist}"), cwd=TREE, check=True, capture_output=True)
    return dist / "apt"


def apt(state: Path, out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run apt of a machine of its own, whose only source is the repository."""
    for name in ("lists/partial", "cache/archives/partial", "etc/apt.conf.d"):
        (state / name).mkdir(parents=True, exist_ok=True)
    (state / "status").touch()
    source = f"deb [arch=amd64 signed-by={out}/tacshade-edge.asc] file:{out} bookworm main\n"
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


@pytest.mark.usefixtures("key")
def test_apt_installs_what_is_signed_and_refuses_what_was_changed_afterwards(tmp_path: Path) -> None:
    package(tmp_path, "1.0.0")
    package(tmp_path, "1.0.0", "aarch64")
    out = lay_out(tmp_path)
    done = apt(tmp_path / "state", out, "update")
    assert done.returncode == 0, done.stderr
    assert "W:" not in done.stderr, done.stderr
    done = apt(tmp_path / "state", out, "install", "--simulate", "tacshade-edge")
    assert "Inst tacshade-edge (1.0.0+deb12 tacshade-edge:bookworm [amd64])" in done.stdout, done.stderr
    for name in ("InRelease", "Release"):
        signed = out / "dists/bookworm" / name
        signed.write_text(signed.read_text().replace("Label: tacshade-edge", "Label: other"))
    done = apt(tmp_path / "other", out, "update")
    assert done.returncode != 0
    assert "signature" in done.stderr
