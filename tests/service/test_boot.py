"""The service under a real systemd as PID 1, with its real unit; once, then judged scene by scene."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from support.booted_machine import CHECKOUT, cannot_boot, fetch, seen_there
from support.calibrated_sensor import FULL, calibrated
from support.shared import once_for_all_workers

from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.patience import stretched

WATCHDOG_S, STOP_S, MEMORY_MAX_MB = 10.0, 2.0, 150

pytestmark = pytest.mark.slow


def copy_checkout(folder: Path) -> None:
    """The tree as a clone has it, as far as an installation needs it."""
    for name in ("systemd", "config", "tacshade_edge"):
        shutil.copytree(CHECKOUT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "tools/release").mkdir(parents=True)
    for name in ("pyproject.toml", "README.md", "LICENSE", "tools/release/version.py"):
        shutil.copy(CHECKOUT / name, folder / name)


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if reason := cannot_boot():
        pytest.skip(reason)
    return once_for_all_workers("the booted service", lambda: booted(tmp_path_factory.mktemp("boot")))


def booted(folder: Path) -> dict[str, Any]:
    calibration_file.save(folder / "calibration.npz", calibrated(FULL))
    copy_checkout(folder / "checkout")
    fetch(folder / "wheels")
    python = f"/opt/python/bin/python{sys.version_info[0]}.{sys.version_info[1]}"
    binds = [f"--bind-ro={sys.base_prefix}:/opt/python", f"--bind-ro={folder / 'wheels'}:/wheels"]
    return seen_there(folder, "scenario.py", python, *binds)


def streams(now: dict[str, str]) -> bool:
    return now["ActiveState"] == "active" and now["StatusText"].startswith("streaming, ")


def test_the_installed_unit_is_valid_and_enabled(seen: dict[str, Any]) -> None:
    install = seen["install"]
    code, output = install["first"]
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
    assert (code, output) == (0, "uninstalled; kept: /var/lib/tacshade-edge (calibrations) and the user tacshade-edge")
    assert gone["again"] == gone["done"]
    assert gone["files"] == seen["install"]["before"]
    assert gone["calibration"]
    assert (gone["now"]["LoadState"], gone["now"]["ActiveState"], gone["now"]["MainPID"]) == (
        "not-found",
        "inactive",
        "0",
    )
    assert gone["enabled"][0] != 0


def test_it_becomes_ready_and_streams_unprivileged(seen: dict[str, Any]) -> None:
    starts = seen["starts"]
    assert starts["code"] == 0, seen["journal"]
    assert starts["at_ready"]["ActiveState"] == "active"
    assert streams(starts["now"]), starts["now"]
    process = starts["process"]
    assert "0" not in process["Uid"].split()
    assert (int(process["CapEff"], 16), process["NoNewPrivs"], process["Seccomp"]) == (0, "1", "2")
    print(f"READY after {starts['ready_s']:.2f} s")


def test_a_killed_process_is_restarted(seen: dict[str, Any]) -> None:
    before, after = seen["killed"]["before"], seen["killed"]["after"]
    assert streams(after)
    assert after["NRestarts"] == "1"
    assert after["MainPID"] != before["MainPID"]


def test_a_reload_of_a_bad_file_keeps_it_running(seen: dict[str, Any]) -> None:
    reloads = seen["reloads"]
    assert reloads["bad"][0] == 0
    assert "config.yaml:1: profile: found slow, expected one of" in reloads["refused"]["StatusText"]
    assert streams(reloads["still"])
    assert streams(reloads["good"])
    assert "rejected" not in reloads["good"]["StatusText"]
    assert {reloads[key]["MainPID"] for key in ("refused", "still", "good")} == {reloads["before"]["MainPID"]}


def test_the_watchdog_kills_a_process_whose_reconstruction_hangs(seen: dict[str, Any]) -> None:
    """Camera, broker link and main thread go on all the while."""
    hangs = seen["hangs"]
    assert hangs["without"]["StatusText"] == "streaming, 0.0 frames/s"
    assert "Watchdog timeout" in hangs["journal"]
    assert "daemon/pipeline.py" in hangs["journal"].split("Watchdog timeout")[-1], "it logs where each thread was"
    assert streams(hangs["after"])
    assert int(hangs["after"]["NRestarts"]) == int(hangs["before"]["NRestarts"]) + 1
    assert hangs["seconds"] < WATCHDOG_S + stretched(20)
    print(f"streams again {hangs['seconds']:.1f} s after it hung")


def test_frames_keep_the_watchdog_content_and_the_memory_stays_under_its_limit(seen: dict[str, Any]) -> None:
    works = seen["works_a_while"]
    assert streams(works["now"])
    assert works["now"]["MainPID"] == works["before"]["MainPID"]
    assert works["now"]["WatchdogUSec"] == f"{WATCHDOG_S:.0f}s"
    assert int(works["now"]["MemoryMax"]) == MEMORY_MAX_MB * 2**20
    own_mb, peak_mb = (int(works["process"][key].split()[0]) / 1024 for key in ("RssAnon", "VmHWM"))
    assert own_mb < MEMORY_MAX_MB  # mapped libraries can be dropped and read again, so they do not exhaust the limit
    print(f"own memory {own_mb:.0f} MB; resident with mapped libraries and simulator at most {peak_mb:.0f} MB")


def test_a_stop_is_quick_and_clean(seen: dict[str, Any]) -> None:
    stops = seen["stops"]
    assert stops["code"] == 0
    assert stops["seconds"] < stretched(STOP_S)
    now = stops["now"]
    assert (now["ActiveState"], now["Result"], now["ExecMainStatus"]) == ("inactive", "success", "0")


def test_an_absent_camera_is_no_restart_loop(seen: dict[str, Any]) -> None:
    absent = seen["camera_is_absent"]
    assert absent["code"] == 0
    assert absent["now"]["ActiveState"] == "active"
    assert absent["now"]["StatusText"].startswith("away (camera /dev/video99: ")
    assert absent["now"]["NRestarts"] == "0"
    assert absent["now"]["MainPID"] == absent["before"]["MainPID"]


def test_bad_configuration_is_not_restarted(seen: dict[str, Any]) -> None:
    bad = seen["configuration_is_bad"]
    assert bad["code"] != 0
    assert (bad["failed"]["ActiveState"], bad["failed"]["ExecMainStatus"]) == ("failed", "78")
    assert (bad["later"]["ActiveState"], bad["later"]["NRestarts"]) == ("failed", "0")
