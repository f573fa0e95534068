"""The container image: built of Debian's packages and the lock's wheels, then run on a kernel's camera (tools/rig)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.booted_machine import fetch

from tacshade_edge.storage.calibration import calibration_file
from tools.release.version import version
from tools.testbed.painted_sensor import FREE, TOUCHED, enlarged, enlarged_calibration

TREE = Path(__file__).parents[2]
GUEST, CANNOT = [sys.executable, "-m", "tools.rig.guest"], 77
BASES = {(3, 11): "bookworm", (3, 13): "trixie"}
MEMORY_MAX = 150 * 2**20

pytestmark = [pytest.mark.slow, pytest.mark.container]


def done(*command: str | Path, **environment: str) -> str:
    """Run a command, which must succeed; return its output."""
    found = subprocess.run(command, cwd=TREE, env=os.environ | environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, (command, found.stdout[-2000:], found.stderr[-2000:])
    return found.stdout


def base(python: tuple[int, int]) -> Path:
    """The root of a small Debian with its Python, made once."""
    made = TREE / ".rig" / f"base-{BASES[python]}.tar"
    if not made.exists():
        made.parent.mkdir(exist_ok=True)
        part = made.with_suffix(".part.tar")
        done("mmdebstrap", "--quiet", "--variant=minbase", "--include=python3,python3-venv", BASES[python], part)
        part.rename(made)
    return made


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
        # Without namespaces of its own, which not every machine lets a build have.
        words = ("--isolation", "chroot", "--build-arg", "BASE=localhost/base", "--tag", "localhost/tacshade-edge")
        words += ("--build-arg", f"TACSHADE_EDGE_VERSION={built_version}", "--file", "Containerfile")
        words += ("--volume", f"{wheels}:/wheels:ro", "--volume", f"{folder}/pip.conf:/etc/pip.conf:ro")
        done(*podman, "build", "--quiet", *words, ".")
        found = json.loads(done(*podman, "inspect", "localhost/tacshade-edge"))[0]
        (folder / "version").write_text(built_version)  # a commit while it is built gives the tree another one
        (folder / "image.json").write_text(json.dumps(found["Config"]))
        print(f"the image has {found['Size'] / 1e6:.0f} MB, its base {base(python).stat().st_size / 1e6:.0f} MB")
        made = done(*podman, "create", "localhost/tacshade-edge").strip()
        (folder / "root").mkdir()
        done("sh", "-c", f'{" ".join(podman)} export {made} | tar -x -C "{folder}/root"')
        calibration_file.save(folder / "calibration.npz", enlarged_calibration())
        np.save(folder / "images.npy", np.stack([enlarged(FREE)] * 2 + [enlarged(TOUCHED)] * 8))
        yield folder
    finally:
        for name in ("storage", "root"):
            shutil.rmtree(folder / name, ignore_errors=True)


@pytest.fixture(scope="module")
def seen(built: Path) -> dict[str, Any]:
    out = built / "out"
    scenario = (sys.executable, "tests/service/scenario_container.py", str(built))
    guest = [*GUEST, "--out", str(out), "env", f"PYTHONPATH={TREE}/tests:{TREE}", *scenario]
    found = subprocess.run(guest, cwd=TREE, capture_output=True, text=True, check=False)
    if found.returncode == CANNOT:
        pytest.skip(f"no guest with a camera: {found.stderr.strip()}")
    assert found.returncode == 0, (found.stdout[-2000:], found.stderr[-2000:])
    result: dict[str, Any] = json.loads((out / "seen.json").read_text())
    return result


def test_it_is_the_program_and_no_root(built: Path) -> None:
    image = json.loads((built / "image.json").read_text())
    assert image["User"] == "10001:10001"
    assert (image["Entrypoint"], image["Cmd"]) == (["tacshade-edge"], ["run"])
    assert list(image["Volumes"]) == ["/var/lib/tacshade-edge"]
    found = done(
        "chroot", "--userspec=10001:10001", built / "root", "/opt/tacshade-edge/bin/tacshade-edge", "--version"
    )
    assert found == f"tacshade-edge {(built / 'version').read_text()}\n"
    assert not (built / "root/src").exists()


def test_it_makes_height_maps_of_a_camera_that_it_is_given(seen: dict[str, Any]) -> None:
    assert seen["camera"]["state"] == "streaming"
    process = seen["process"]
    assert set(process["Uid"].split()) == {"10001"}
    assert (int(process["CapEff"], 16), process["NoNewPrivs"]) == (0, "1")


def test_it_does_so_within_the_services_memory(seen: dict[str, Any]) -> None:
    assert seen["limit"] == MEMORY_MAX
    print(f"own memory {seen['own'] / 1e6:.0f} MB")


def test_a_stop_is_clean_and_leaves_the_calibration(seen: dict[str, Any]) -> None:
    assert seen["code"] == 0
    assert seen["state"] == "stopped"
    assert "calibration.npz" in seen["files"]
