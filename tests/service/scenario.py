#!/usr/bin/python3
"""Runs as root under a booted systemd without a network (tools/rig/boot_systemd.sh):
uses the service as people would.

It is installed from a clone, and then, where there are packages, by apt. Only what was seen is
written; test_boot.py judges. Standard library only.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import signal
import sys
import time
from pathlib import Path
from typing import Any

from support.booted_service import (
    CONFIG,
    UNIT,
    fresh,
    frozen,
    journal,
    process,
    report,
    sh,
    show,
    streaming,
    threads,
    until,
)

GOOD = "# mine\nsource: {kind: simulated, fps: 5}\n"
WATCHDOG_S = 10.0
FED = "WatchdogTimestampMonotonic"
STATE = Path("/var/lib/tacshade-edge")
INSTALL = "/payload/checkout/systemd/install.sh"
OLDER, NEWER = Path("/payload/older.deb"), Path("/payload/newer.deb")
# What neither installation may leave behind.
PLACES = (
    "/opt",
    "/usr/local/bin",
    "/usr/local/lib/systemd",
    "/usr/local/lib/sysusers.d",
    "/etc/udev/rules.d",
    "/etc/mosquitto",
    "/etc/tacshade-edge",
    "/etc/systemd/system",
    "/usr/lib/udev/rules.d",
    "/usr/bin",
)


def files() -> list[str]:
    found = (
        path
        for place in PLACES
        for path in Path(place).rglob("*")
        if path.is_file() or path.is_symlink()
    )
    named = (str(path) for path in (*found, *Path("/usr/lib").glob("s*/**/tacshade-edge*")))
    return sorted(name for name in named if not name.startswith("/opt/python/"))


def calibration() -> dict[str, str]:
    """Every one in the service's own folder."""
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in STATE.rglob("*.npz")
    }


def install_sh(*words: str) -> tuple[int, str]:
    """As root on a machine that has the packages at hand instead of a network."""
    return sh(
        INSTALL,
        *words,
        PYTHON=f"/opt/python/bin/{sys.argv[1]}",
        PIP_NO_INDEX="1",
        PIP_FIND_LINKS="/wheels",
    )


def apt(*words: str) -> tuple[int, str]:
    options = ("--no-install-recommends", "-o", "Dpkg::Options::=--force-confold")
    return sh("apt-get", "-qq", *options, *words, DEBIAN_FRONTEND="noninteractive")


def installed(unit: str) -> dict[str, Any]:
    """What systemd makes of the installation, and whose the settings are."""
    config = CONFIG.stat()
    whose = (
        config.st_uid,
        sh("id", "-g", "tacshade-edge")[1] == str(config.st_gid),
        oct(CONFIG.parent.stat().st_mode),
    )
    verify, enabled = sh("systemd-analyze", "verify", unit), sh("systemctl", "is-enabled", UNIT)
    return {"verify": verify, "enabled": enabled, "access": whose, "owner": STATE.owner()}


def installs() -> dict[str, Any]:
    # A Python below /root names its library there, where the unit must not look.
    Path("/etc/ld.so.conf.d/00-python.conf").write_text("/opt/python/lib\n")
    sh("ldconfig")
    before = files()
    done = install_sh()
    sh("install", "-o", "tacshade-edge", "/payload/calibration.npz", str(STATE))
    return {"before": before, "done": done, **installed(f"/usr/local/lib/systemd/system/{UNIT}")}


def starts() -> dict[str, Any]:
    began = time.monotonic()
    code = fresh(GOOD)
    ready_s = time.monotonic() - began
    at_ready = show()
    now = until(streaming, 20)
    return {
        "code": code,
        "ready_s": ready_s,
        "at_ready": at_ready,
        "now": now,
        "process": process(now["MainPID"]),
    }


def killed() -> dict[str, Any]:
    before = show()
    os.kill(int(before["MainPID"]), signal.SIGKILL)
    after = until(lambda now: streaming(now) and now["NRestarts"] == "1", 20)
    return {"before": before, "after": after}


def reloads() -> dict[str, Any]:
    before = show()
    CONFIG.write_text("profile: slow\n" + GOOD)
    bad = sh("systemctl", "reload", UNIT)
    still = until(lambda now: streaming(now) and "rejected" in now["StatusText"], 10)
    CONFIG.write_text(GOOD)
    sh("systemctl", "reload", UNIT)
    good = until(lambda now: streaming(now) and "rejected" not in now["StatusText"], 10)
    return {"before": before, "bad": bad, "still": still, "good": good}


def hangs() -> dict[str, Any]:
    """The thread `reconstruct` alone, in whatever it does:
    the last that a start makes (architecture.md).
    """
    fresh(GOOD)
    before = show()
    last = threads(before["MainPID"])[-1]
    until(streaming, 20)
    began = time.monotonic()
    with frozen(last):
        without = until(lambda now: now["StatusText"] == "streaming, 0.0 frames/s", 8)
        until(lambda now: now["NRestarts"] != before["NRestarts"], 30)
    after = until(streaming, 20)
    seen = {"before": before, "without": without, "after": after, "journal": journal()}
    return {"seconds": time.monotonic() - began, **seen}


def stops() -> dict[str, Any]:
    began = time.monotonic()
    code = sh("systemctl", "stop", UNIT)[0]
    return {"code": code, "seconds": time.monotonic() - began, "now": show()}


def camera_is_absent() -> dict[str, Any]:
    """For longer than the watchdog's time, so that only its feeding keeps it."""
    code = fresh("source: {kind: v4l2, device: /dev/video99}\n")
    before = show()
    fed_us = int(before[FED]) + int(1.2e6 * WATCHDOG_S)
    now = until(lambda now: int(now[FED]) > fed_us or now["NRestarts"] != "0", 20)
    return {"code": code, "before": before, "now": now}


def configuration_is_bad() -> dict[str, Any]:
    code = fresh("profile: slow\n" + GOOD)
    # What is to be restarted waits in another state, `auto-restart`, until it is.
    failed = until(lambda now: now["SubState"] == "failed", 10)
    return {"code": code, "failed": failed}


def package_is_refused() -> dict[str, Any]:
    return {"done": apt("install", str(OLDER))}


def uninstalls() -> dict[str, Any]:
    """While it runs; then once more."""
    default = Path("/payload/checkout/config/default.yaml")
    running = fresh(default.read_text().replace("kind: v4l2", "kind: v4l2 # mine"))
    shutil.copy(default, CONFIG)
    done = install_sh("--uninstall")
    again = install_sh("--uninstall")
    enabled = sh("systemctl", "is-enabled", UNIT)
    left = {"files": files(), "enabled": enabled, "calibration": calibration()}
    return {"running": running, "done": done, "again": again, "now": show(), **left}


def package_installs() -> dict[str, Any]:
    done = apt("install", str(OLDER))
    version = sh("tacshade-edge", "--version")
    return {
        "done": done,
        "now": show(),
        "version": version,
        **installed(f"/usr/lib/systemd/system/{UNIT}"),
    }


def package_upgrades() -> dict[str, Any]:
    """Over the running service, to a package with other default settings."""
    fresh(GOOD)
    before = until(streaming, 20)
    done = apt("install", str(NEWER))
    now = until(streaming, 20)
    proposed = Path(f"{CONFIG}.dpkg-dist").exists()
    seen = {
        "before": before,
        "done": done,
        "now": now,
        "config": CONFIG.read_text(),
        "proposed": proposed,
    }
    CONFIG.write_text("profile: slow\n" + GOOD)
    sh("systemctl", "reload", UNIT)
    until(lambda now: "rejected" in now["StatusText"], 10)
    CONFIG.write_text(GOOD)
    sh("journalctl", "--sync")
    seen |= {
        "warnings": sh("journalctl", "--unit", UNIT, "--priority=warning", "--output=json")[1],
        "changed": sh("dpkg", "--verify", "tacshade-edge")[1],
        "version": sh("tacshade-edge", "--version"),
    }
    return {
        **seen,
        "calibration": calibration(),
        "dropped": [path for path in files() if path.endswith("/dropped.py")],
    }


def clone_is_refused() -> dict[str, Any]:
    return {"done": sh(INSTALL)}


def package_is_removed() -> dict[str, Any]:
    """While it runs."""
    done = apt("remove", "tacshade-edge")
    left = [path for path in files() if "tacshade" in path]
    return {
        "done": done,
        "now": show(),
        "left": left,
        "config": CONFIG.read_text(),
        "calibration": calibration(),
    }


def package_is_purged() -> dict[str, Any]:
    done = apt("purge", "tacshade-edge")
    left = {"files": files(), "etc": CONFIG.parent.exists(), "calibration": calibration()}
    return {"done": done, **left, "user": sh("id", "-un", "tacshade-edge")}


def main() -> None:
    clone = (
        installs,
        starts,
        killed,
        reloads,
        hangs,
        stops,
        camera_is_absent,
        configuration_is_bad,
    )
    package = (
        package_installs,
        package_upgrades,
        clone_is_refused,
        package_is_removed,
        package_is_purged,
    )
    report(
        *clone, *((package_is_refused, uninstalls, *package) if OLDER.exists() else (uninstalls,))
    )


if __name__ == "__main__":
    main()
