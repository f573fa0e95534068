"""The service under a real systemd as PID 1, installed from a clone and by its Debian package;
once, then judged scene by scene.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from support.booted_machine import CHECKOUT, cannot_boot, fetch, seen_there
from support.calibrated_sensor import FULL, calibrated
from support.patience import stretched
from support.shared import once_for_all_workers
from tacshade_edge.calibration.files import calibration_file
from tools.release.package_debian import CONFFILES, RELEASES
from tools.release.version import version

WATCHDOG_S, STOP_S, MEMORY_MAX_MB = 10.0, 2.0, 150
OLDER = "0.0.1"

pytestmark = pytest.mark.slow


def debians_python() -> str:
    """The version of Debian's own Python; empty where it is not installed as a package."""
    architecture = subprocess.run(
        ["dpkg", "--print-architecture"], capture_output=True, text=True, check=False
    ).stdout.strip()
    words = ["/usr/bin/python3", "-c", "import sys; print('%d.%d' % sys.version_info[:2])"]
    found = subprocess.run(words, capture_output=True, text=True, check=False).stdout.strip()
    owned = (
        subprocess.run(["dpkg", "--status", "python3"], capture_output=True, check=False).returncode
        == 0
    )
    return found if owned and architecture == "amd64" and found in RELEASES else ""


def built(folder: Path) -> Path | str:
    """The package for this machine, or why there is none."""
    if shutil.which("dpkg-deb") is None or not (python := debians_python()):
        return "not an x86-64 Debian with its python3, of 3.11 or 3.13"
    if find_spec("uv") is None or find_spec("hatchling") is None:
        return "uv or hatchling is not installed"
    words = [
        "-m",
        "tools.release.package_debian",
        "--machine",
        "x86_64",
        "--python",
        python,
        "--level",
        "1",
    ]
    command = [sys.executable, *words, "--out", str(folder)]
    done = subprocess.run(command, cwd=CHECKOUT, capture_output=True, text=True, check=False)
    if "Failed to fetch" in done.stderr:
        return f"the program's packages cannot be fetched here: {done.stderr.strip()[-300:]}"
    assert done.returncode == 0, done.stderr
    print(done.stdout)
    (made,) = folder.iterdir()
    return made


def make_older(package: Path, folder: Path) -> None:
    """The release before: a lower version, other default settings,
    a module that is dropped since.
    """
    root = folder / "root"
    subprocess.run(["dpkg-deb", "--raw-extract", package, root], check=True)
    control = root / "DEBIAN/control"
    control.write_text(
        control.read_text().replace(
            f"Version: {field(package, 'Version')}\n", f"Version: {OLDER}\n"
        )
    )
    (about,) = root.glob("opt/tacshade-edge/lib/*/site-packages/tacshade_edge-*.dist-info/METADATA")
    about.write_text(
        about.read_text().replace(f"\nVersion: {version()}\n", f"\nVersion: {OLDER}\n")
    )
    (about.parents[1] / "tacshade_edge/dropped.py").touch()
    with (root / CONFFILES[0]).open("a") as settings:
        settings.write("# as it was\n")
    command = ["dpkg-deb", "--root-owner-group", "-Znone", "--build", root, folder / "older.deb"]
    subprocess.run(command, check=True, capture_output=True)
    shutil.rmtree(root)


def copy_checkout(folder: Path) -> None:
    """The tree as a clone has it, as far as an installation needs it."""
    for name in ("systemd", "config", "tacshade_edge"):
        shutil.copytree(
            CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__")
        )
    (folder / "tools/release").mkdir(parents=True)
    for name in ("pyproject.toml", "README.md", "LICENSE", "tools/release/version.py"):
        shutil.copy(CHECKOUT / name, folder / name)


def booted(folder: Path, package: Path | str) -> dict[str, Any]:
    calibration_file.save(folder / "calibration.npz", calibrated(FULL))
    copy_checkout(folder / "checkout")
    if isinstance(package, Path):
        make_older(package, folder)
        (folder / "newer.deb").hardlink_to(package)
    fetch(folder / "wheels")
    python = f"/opt/python/bin/python{sys.version_info[0]}.{sys.version_info[1]}"
    binds = [f"--bind-ro={sys.base_prefix}:/opt/python", f"--bind-ro={folder / 'wheels'}:/wheels"]
    return seen_there(folder, "scenario.py", python, *binds)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path | str:
    return once_for_all_workers("the package", lambda: built(tmp_path_factory.mktemp("package")))


@pytest.fixture(scope="module")
def seen(made: Path | str, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if reason := cannot_boot():
        pytest.skip(reason)
    return once_for_all_workers(
        "the booted service", lambda: booted(tmp_path_factory.mktemp("boot"), made)
    )


@pytest.fixture
def package(made: Path | str) -> Path:
    if isinstance(made, str):
        pytest.skip(made)
    return made


def field(package: Path, name: str) -> str:
    field = subprocess.run(
        ["dpkg-deb", "--field", package, name], capture_output=True, text=True, check=True
    )
    return field.stdout.strip()


def streams(now: dict[str, str]) -> bool:
    return now["ActiveState"] == "active" and now["StatusText"].startswith("streaming, ")


def test_the_installed_unit_is_valid_and_enabled(seen: dict[str, Any]) -> None:
    install = seen["installs"]
    code, output = install["done"]
    assert code == 0, output
    assert output.startswith("installed; ")
    assert "ailed" not in output
    assert install["verify"] == [0, ""]
    assert install["enabled"] == [0, "enabled"]
    assert install["access"] == [0, True, "0o40750"]


def test_uninstalling_leaves_nothing_but_what_it_says(seen: dict[str, Any]) -> None:
    gone = seen["uninstalls"]
    assert gone["running"] == 0
    code, output = gone["done"]
    assert (code, output) == (
        0,
        "uninstalled; kept: /var/lib/tacshade-edge (calibrations) and the user tacshade-edge",
    )
    assert gone["again"] == gone["done"]
    assert gone["files"] == seen["installs"]["before"]
    assert gone["calibration"]
    states = [gone["now"][name] for name in ("LoadState", "ActiveState", "MainPID")]
    assert states == ["not-found", "inactive", "0"]
    assert gone["enabled"][0] != 0


def test_it_becomes_ready_and_streams_unprivileged_within_its_limits(seen: dict[str, Any]) -> None:
    starts = seen["starts"]
    assert starts["code"] == 0, seen["journal"]
    assert starts["at_ready"]["ActiveState"] == "active"
    assert streams(starts["now"]), starts["now"]
    assert starts["now"]["WatchdogUSec"] == f"{WATCHDOG_S:.0f}s"
    assert int(starts["now"]["MemoryMax"]) == MEMORY_MAX_MB * 2**20
    process = starts["process"]
    assert "0" not in process["Uid"].split()
    assert (int(process["CapEff"], 16), process["NoNewPrivs"], process["Seccomp"]) == (0, "1", "2")
    own_mb = int(process["RssAnon"].split()[0]) / 1024
    assert (
        own_mb < MEMORY_MAX_MB
    )  # mapped libraries can be dropped and read again, so they do not exhaust the limit
    print(f"READY after {starts['ready_s']:.2f} s; own memory {own_mb:.0f} MB")


def test_a_killed_process_is_restarted(seen: dict[str, Any]) -> None:
    before, after = seen["killed"]["before"], seen["killed"]["after"]
    assert streams(after)
    assert after["NRestarts"] == "1"
    assert after["MainPID"] != before["MainPID"]


def test_a_reload_of_a_bad_file_keeps_it_running(seen: dict[str, Any]) -> None:
    reloads = seen["reloads"]
    assert reloads["bad"][0] == 0
    assert "config.yaml:1: profile: found slow, expected one of" in reloads["still"]["StatusText"]
    assert streams(reloads["still"])
    assert streams(reloads["good"])
    assert "rejected" not in reloads["good"]["StatusText"]
    assert reloads["before"]["MainPID"] == reloads["still"]["MainPID"] == reloads["good"]["MainPID"]


def test_the_watchdog_kills_a_process_whose_reconstruction_hangs(seen: dict[str, Any]) -> None:
    """Camera, broker link and main thread go on all the while."""
    hangs = seen["hangs"]
    assert hangs["without"]["StatusText"] == "streaming, 0.0 frames/s"
    assert "Watchdog timeout" in hangs["journal"]
    assert "pipeline/pipeline.py" in hangs["journal"].split("Watchdog timeout")[-1], (
        "it logs where each thread was"
    )
    assert streams(hangs["after"])
    assert int(hangs["after"]["NRestarts"]) == int(hangs["before"]["NRestarts"]) + 1
    assert hangs["seconds"] < WATCHDOG_S + stretched(20)
    print(f"streams again {hangs['seconds']:.1f} s after it hung")


def test_a_stop_is_quick_and_clean(seen: dict[str, Any]) -> None:
    stops = seen["stops"]
    assert stops["code"] == 0
    assert stops["seconds"] < stretched(STOP_S)
    now = stops["now"]
    assert (now["ActiveState"], now["Result"], now["ExecMainStatus"]) == (
        "inactive",
        "success",
        "0",
    )


def test_an_absent_camera_is_no_restart_loop(seen: dict[str, Any]) -> None:
    absent = seen["camera_is_absent"]
    assert absent["code"] == 0
    assert absent["now"]["ActiveState"] == "active"
    assert absent["now"]["StatusText"].startswith("away (camera /dev/video99: ")
    assert absent["now"]["NRestarts"] == "0"
    assert absent["now"]["MainPID"] == absent["before"]["MainPID"]
    fed_us = [int(absent[when]["WatchdogTimestampMonotonic"]) for when in ("before", "now")]
    assert fed_us[1] - fed_us[0] > WATCHDOG_S * 1e6


def test_bad_configuration_is_not_restarted(seen: dict[str, Any]) -> None:
    bad = seen["configuration_is_bad"]
    assert bad["code"] != 0
    assert (bad["failed"]["SubState"], bad["failed"]["ExecMainStatus"]) == ("failed", "78")
    assert bad["failed"]["NRestarts"] == "0"


def test_the_package_says_what_it_is(package: Path) -> None:
    python = debians_python()
    assert field(package, "Version").startswith(version().replace(".dev", "~dev"))
    assert field(package, "Depends").startswith(f"python3 (>= {python}~), ")
    listed = subprocess.run(
        ["dpkg-deb", "--contents", package], capture_output=True, text=True, check=True
    ).stdout
    rows = [line.split() for line in listed.splitlines()]
    assert {row[1] for row in rows} == {"root/root"}
    assert [row for row in rows if row[0][0] != "l" and "w" in (row[0][5], row[0][8])] == []
    names = {row[5].removeprefix(".") for row in rows}
    assert {f"/{name}" for name in CONFFILES} <= names
    packages = f"/opt/tacshade-edge/lib/python{python}/site-packages"
    assert f"{packages}/tacshade_edge/sensor/inference/weights/fast.onnx" in names
    assert [name for name in names if name.endswith((".pyc", "direct_url.json"))] == []


def test_the_package_is_installed_and_enabled(package: Path, seen: dict[str, Any]) -> None:
    installs = seen["package_installs"]
    code, output = installs["done"]
    assert code == 0, output
    assert "installed; calibrate, " in output
    assert installs["verify"] == [0, ""]
    assert installs["enabled"] == [0, "enabled"]
    assert installs["access"] == [0, True, "0o40750"]
    assert installs["owner"] == "tacshade-edge"
    assert installs["now"]["ActiveState"] == "inactive"
    assert installs["version"] == [0, f"tacshade-edge {OLDER}"]


def test_an_upgrade_restarts_it_with_its_settings_and_its_calibration(
    package: Path, seen: dict[str, Any]
) -> None:
    upgrades = seen["package_upgrades"]
    assert streams(upgrades["before"]), seen["journal"]
    code, output = upgrades["done"]
    assert code == 0, output
    assert upgrades["version"] == [0, f"tacshade-edge {version()}"]
    assert streams(upgrades["now"]), upgrades["now"]
    assert upgrades["now"]["MainPID"] != upgrades["before"]["MainPID"]
    assert upgrades["config"].startswith("# mine\n")
    assert upgrades["proposed"], "the new defaults lie beside"
    assert upgrades["calibration"] == seen["uninstalls"]["calibration"]
    assert upgrades["dropped"] == []
    changed = [line.split()[-1] for line in upgrades["changed"].splitlines()]
    assert changed == ["/etc/tacshade-edge/config.yaml"]


def test_the_journal_has_priorities_and_with_the_package_fields(
    package: Path, seen: dict[str, Any]
) -> None:
    lines = seen["package_upgrades"]["warnings"].splitlines()
    of_clone, of_package = [
        entry for entry in map(json.loads, lines) if "rejected the reload" in entry["MESSAGE"]
    ]
    assert of_clone["PRIORITY"] == of_package["PRIORITY"] == "4"
    assert of_package["SENSOR_ID"] == "tacshade"
    assert of_package["CODE_FILE"].endswith("/tacshade_edge/daemon/app.py")


def test_one_installation_refuses_the_other(package: Path, seen: dict[str, Any]) -> None:
    code, output = seen["package_is_refused"]["done"]
    assert code != 0
    assert "expected its --uninstall first" in output
    code, output = seen["clone_is_refused"]["done"]
    assert code == 1
    assert output.startswith("install.sh: found the Debian package, expected apt-get remove")


def test_removal_leaves_settings_and_calibration(package: Path, seen: dict[str, Any]) -> None:
    gone = seen["package_is_removed"]
    assert gone["done"][0] == 0, gone["done"]
    assert (gone["now"]["LoadState"], gone["now"]["MainPID"]) == ("not-found", "0")
    assert gone["config"].startswith("# mine\n")
    assert gone["calibration"] == seen["uninstalls"]["calibration"]
    assert [path for path in gone["left"] if not path.startswith("/etc/")] == []


def test_a_purge_leaves_the_calibration_and_its_owner(package: Path, seen: dict[str, Any]) -> None:
    gone = seen["package_is_purged"]
    assert gone["done"][0] == 0, gone["done"]
    assert gone["files"] == seen["installs"]["before"]
    assert not gone["etc"]
    assert gone["calibration"] == seen["uninstalls"]["calibration"]
    assert gone["user"] == [0, "tacshade-edge"]
