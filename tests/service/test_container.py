"""The container image, built of Debian's packages and the lock's wheels."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.booted_machine import fetch
from tools.release.version import version

TREE = Path(__file__).parents[2]
BASES = {(3, 11): "bookworm", (3, 13): "trixie"}

pytestmark = [pytest.mark.slow, pytest.mark.container]


def done(*command: str | Path, **environment: str) -> str:
    """Run a command, which must succeed; return its output."""
    found = subprocess.run(
        command, cwd=TREE, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, (command, found.stdout[-2000:], found.stderr[-2000:])
    return found.stdout


def base(python: tuple[int, int]) -> Path:
    """The root of a small Debian with its Python, made once."""
    made = TREE / ".rig" / f"base-{BASES[python]}.tar"
    if not made.exists():
        made.parent.mkdir(exist_ok=True)
        part = made.with_suffix(".part.tar")
        done(
            "mmdebstrap",
            "--quiet",
            "--variant=minbase",
            "--include=python3,python3-venv",
            BASES[python],
            part,
        )
        part.rename(made)
    return made


def build_options(folder: Path, wheels: Path, built_version: str) -> list[str]:
    """Without namespaces of its own, which not every machine lets a build have."""
    words = ["--isolation", "chroot", "--file", "Containerfile"]
    words += ["--tag", "localhost/tacshade-edge", "--build-arg", "BASE=localhost/base"]
    words += ["--build-arg", f"TACSHADE_EDGE_VERSION={built_version}"]
    words += ["--volume", f"{wheels}:/wheels:ro"]
    return [*words, "--volume", f"{folder}/pip.conf:/etc/pip.conf:ro"]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with the image's files in `root` and its configuration in image.json."""
    python = sys.version_info[:2]
    if os.getuid() != 0:
        pytest.skip("making a root file system needs root")
    if missing := [name for name in ("podman", "mmdebstrap") if shutil.which(name) is None]:
        pytest.skip(f"not installed: {' '.join(missing)}")
    if python not in BASES:
        pytest.skip("Debian has no release of this Python, for which the wheels are")
    folder = tmp_path_factory.mktemp("container")
    wheels = fetch(folder / "wheels")
    (folder / "pip.conf").write_text("[global]\nno-index = true\nfind-links = /wheels\n")
    podman = ("podman", "--root", str(folder / "storage"), "--runroot", str(folder / "run"))
    built_version = version()
    try:
        done(*podman, "import", "--quiet", base(python), "localhost/base")
        done(*podman, "build", "--quiet", *build_options(folder, wheels, built_version), ".")
        found = json.loads(done(*podman, "inspect", "localhost/tacshade-edge"))[0]
        # A commit while it is built gives the tree another one.
        (folder / "version").write_text(built_version)
        (folder / "image.json").write_text(json.dumps(found["Config"]))
        print(
            f"the image has {found['Size'] / 1e6:.0f} MB, its base "
            f"{base(python).stat().st_size / 1e6:.0f} MB"
        )
        made = done(*podman, "create", "localhost/tacshade-edge").strip()
        (folder / "root").mkdir()
        done("sh", "-c", f'{" ".join(podman)} export {made} | tar -x -C "{folder}/root"')
        yield folder
    finally:
        for name in ("storage", "root"):
            shutil.rmtree(folder / name, ignore_errors=True)


def test_it_is_the_program_and_no_root(built: Path) -> None:
    image = json.loads((built / "image.json").read_text())
    assert image["User"] == "10001:10001"
    assert (image["Entrypoint"], image["Cmd"]) == (["tacshade-edge"], ["run"])
    assert list(image["Volumes"]) == ["/var/lib/tacshade-edge"]
    found = done(
        "chroot",
        "--userspec=10001:10001",
        built / "root",
        "/opt/tacshade-edge/bin/tacshade-edge",
        "--version",
    )
    assert found == f"tacshade-edge {(built / 'version').read_text()}\n"
    assert not (built / "root/src").exists()
