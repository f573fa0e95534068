"""The Debian package: built for this machine, then installed, upgraded, removed under a real systemd as PID 1."""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from support.booted_machine import CHECKOUT, cannot_boot, seen_there
from support.calibrated_sensor import FULL, calibrated
from support.shared import once_for_all_workers

from tacshade_edge.storage.calibration import calibration_file
from tools.release.package_debian import CONFFILES, RELEASES
from tools.release.version import version

MACHINE = "x86_64"
DEBIANS_PYTHON = "/usr/bin/python3"
OLDER = "0.0.1"

pytestmark = pytest.mark.slow


def python_here() -> str:
    """The version of Debian's own Python; empty where it is not installed as a package."""
    told = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=False).stdout.strip()
    words = [DEBIANS_PYTHON, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    found = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    owned = subprocess.run(["dpkg", "--status", "python3"], capture_output=True, check=False).returncode == 0
    return found if owned and told == "amd64" and found in RELEASES else ""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("dpkg-deb") is None or not (python := python_here()):
        pytest.skip("not an x86-64 Debian with its python3, of 3.11 or 3.13")
    if find_spec("uv") is None or find_spec("hatchling") is None:
        pytest.skip("uv or hatchling is not installed")
    return once_for_all_workers("the package", lambda: built(tmp_path_factory.mktemp("package"), python))


def built(folder: Path, python: str) -> Path:
    words = [
        "-m",
        "tools.release.package_debian",
        "--machine",
        MACHINE,
        "--python",
        python,
        "--out",
        str(folder),
        "--level",
        "1",
    ]
    done = subprocess.run([sys.executable, *words], cwd=CHECKOUT, capture_output=True, text=True, check=False)
    if "Failed to fetch" in done.stderr:
        pytest.skip(f"the program's packages cannot be fetched here: {done.stderr.strip()[-300:]}")
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    (made,) = folder.iterdir()
    return made


def older(package: Path, folder: Path) -> Path:
    """The release before: a lower version, other default settings, a module that is dropped since."""
    root = folder / "root"
    subprocess.run(["dpkg-deb", "--raw-extract", package, root], check=True)
    control = root / "DEBIAN/control"
    control.write_text(control.read_text().replace(f"Version: {field(package, 'Version')}\n", f"Version: {OLDER}\n"))
    (about,) = root.glob("opt/tacshade-edge/lib/*/site-packages/tacshade_edge-*.dist-info/METADATA")
    about.write_text(about.read_text().replace(f"\nVersion: {version()}\n", f"\nVersion: {OLDER}\n"))
    (about.parents[1] / "tacshade_edge/dropped.py").touch()
    with (root / CONFFILES[0]).open("a") as settings:
        settings.write("# as it was\n")
    made = folder / "older.deb"
    subprocess.run(["dpkg-deb", "--root-owner-group", "-Znone", "--build", root, made], check=True, capture_output=True)
    shutil.rmtree(root)
    return made


@pytest.fixture(scope="module")
def seen(package: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if reason := cannot_boot():
        pytest.skip(reason)
    return once_for_all_workers("the booted package", lambda: booted(package, tmp_path_factory.mktemp("boot")))


def booted(package: Path, folder: Path) -> dict[str, Any]:
    calibration_file.save(folder / "calibration.npz", calibrated(FULL))
    older(package, folder)
    (folder / "newer.deb").hardlink_to(package)
    shutil.copytree(CHECKOUT / "systemd", folder / "systemd")
    return seen_there(folder, "scenario_package.py", DEBIANS_PYTHON)


def field(package: Path, name: str) -> str:
    told = subprocess.run(["dpkg-deb", "--field", package, name], capture_output=True, text=True, check=True)
    return told.stdout.strip()


def streams(now: dict[str, str]) -> bool:
    return now["ActiveState"] == "active" and now["StatusText"].startswith("streaming, ")


def test_the_package_says_what_it_is(package: Path) -> None:
    python = python_here()
    assert field(package, "Version").startswith(version().replace(".dev", "~dev"))
    assert field(package, "Depends").startswith(f"python3 (>= {python}~), ")
    listed = subprocess.run(["dpkg-deb", "--contents", package], capture_output=True, text=True, check=True).stdout
    rows = [line.split() for line in listed.splitlines()]
    assert {row[1] for row in rows} == {"root/root"}
    assert [row for row in rows if row[0][0] != "l" and "w" in (row[0][5], row[0][8])] == []
    names = {row[5].removeprefix(".") for row in rows}
    assert {f"/{name}" for name in CONFFILES} <= names
    assert f"/opt/tacshade-edge/lib/python{python}/site-packages/tacshade_edge/inference/weights/fast.onnx" in names
    assert [name for name in names if name.endswith((".pyc", "direct_url.json"))] == []


def test_it_is_installed_and_enabled(seen: dict[str, Any]) -> None:
    installs = seen["installs"]
    code, output = installs["done"]
    assert code == 0, output
    assert "installed; calibrate, " in output
    assert installs["verify"] == [0, ""]
    assert installs["enabled"] == [0, "enabled"]
    assert installs["access"] == [0, True, "0o40750"]
    assert installs["now"]["ActiveState"] == "inactive"
    assert installs["version"] == [0, f"tacshade-edge {OLDER}"]


def test_it_streams_unprivileged(seen: dict[str, Any]) -> None:
    starts = seen["starts"]
    assert starts["owner"] == "tacshade-edge"
    assert starts["code"] == 0, seen["journal"]
    assert streams(starts["now"]), starts["now"]
    assert "0" not in starts["process"]["Uid"].split()


def test_an_upgrade_restarts_it_with_its_settings_and_its_calibration(seen: dict[str, Any]) -> None:
    upgrades = seen["upgrades"]
    code, output = upgrades["done"]
    assert code == 0, output
    assert upgrades["version"] == [0, f"tacshade-edge {version()}"]
    assert streams(upgrades["now"]), upgrades["now"]
    assert upgrades["now"]["MainPID"] != upgrades["before"]["MainPID"]
    assert upgrades["config"].startswith("# mine\n")
    assert upgrades["proposed"], "the new defaults lie beside"
    assert upgrades["calibration"] == seen["starts"]["calibration"]
    assert upgrades["dropped"] == []
    changed = [line.split()[-1] for line in upgrades["changed"].splitlines()]
    assert changed == ["/etc/tacshade-edge/config.yaml"]


def test_one_installation_refuses_the_other(seen: dict[str, Any]) -> None:
    code, output = seen["installs"]["beside"]
    assert code != 0
    assert "expected its --uninstall first" in output
    code, output = seen["refuses_a_second_installation"]["done"]
    assert code == 1
    assert output.startswith("install.sh: found the Debian package, expected apt-get remove")


def test_removal_leaves_settings_and_calibration(seen: dict[str, Any]) -> None:
    gone = seen["removes"]
    assert gone["done"][0] == 0, gone["done"]
    assert (gone["now"]["LoadState"], gone["now"]["MainPID"]) == ("not-found", "0")
    assert gone["config"].startswith("# mine\n")
    assert gone["calibration"] == seen["starts"]["calibration"]
    assert [path for path in gone["left"] if not path.startswith("/etc/")] == []


def test_a_purge_leaves_the_calibration_and_its_owner(seen: dict[str, Any]) -> None:
    gone = seen["purges"]
    assert gone["done"][0] == 0, gone["done"]
    assert gone["files"] == seen["installs"]["before"]
    assert not gone["etc"]
    assert gone["calibration"] == seen["starts"]["calibration"]
    assert gone["user"] == [0, "tacshade-edge"]
