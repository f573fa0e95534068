#!/usr/bin/python3
"""Runs as root under a booted systemd (tools/rig/boot_systemd.sh): uses the service as a person would, prints JSON.

Only what was seen is printed; test_boot.py judges. Standard library only.
"""

from __future__ import annotations

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
    sh,
    show,
    streaming,
    tell,
    threads,
    until,
)

GOOD = "source: {kind: simulated, fps: 5}\n"
WATCHDOG_S = 10.0
INSTALL = "/payload/checkout/systemd/install.sh"
# What install.sh may leave behind nothing of.
PLACES = (
    "/opt",
    "/usr/local/lib/systemd",
    "/usr/local/lib/sysusers.d",
    "/etc/udev/rules.d",
    "/etc/mosquitto",
    "/etc/tacshade-edge",
)


def files() -> list[str]:
    found = (path for place in PLACES for path in Path(place).rglob("*") if path.is_file() or path.is_symlink())
    return sorted(str(path) for path in found if not str(path).startswith("/opt/python/"))


def install_sh(*words: str) -> tuple[int, str]:
    """As root on a machine that has the packages at hand instead of a network."""
    return sh(INSTALL, *words, PYTHON=f"/opt/python/bin/{sys.argv[1]}", PIP_NO_INDEX="1", PIP_FIND_LINKS="/wheels")


def install() -> dict[str, Any]:
    # A Python below /root names its library there, where the unit must not look.
    Path("/etc/ld.so.conf.d/00-python.conf").write_text("/opt/python/lib\n")
    sh("ldconfig")
    before = files()
    first = install_sh()
    sh("install", "-o", "tacshade-edge", "/payload/calibration.npz", "/var/lib/tacshade-edge/")
    verify = sh("systemd-analyze", "verify", f"/usr/local/lib/systemd/system/{UNIT}")
    enabled = sh("systemctl", "is-enabled", UNIT)
    config = CONFIG.stat()
    access = (
        config.st_uid,
        sh("id", "-g", "tacshade-edge")[1] == str(config.st_gid),
        oct(CONFIG.parent.stat().st_mode),
    )
    return {"before": before, "first": first, "enabled": enabled, "verify": verify, "access": access}


def uninstalls() -> dict[str, Any]:
    """While it runs; then once more."""
    shutil.copy("/payload/checkout/config/default.yaml", CONFIG)
    running = fresh(CONFIG.read_text().replace("kind: v4l2", "kind: v4l2 # mine"))
    shutil.copy("/payload/checkout/config/default.yaml", CONFIG)
    done = install_sh("--uninstall")
    again = install_sh("--uninstall")
    enabled = sh("systemctl", "is-enabled", UNIT)
    calibration = Path("/var/lib/tacshade-edge/calibration.npz").exists()
    left = {"files": files(), "enabled": enabled, "calibration": calibration}
    return {"running": running, "done": done, "again": again, "now": show(), **left}


def starts() -> dict[str, Any]:
    began = time.monotonic()
    code = fresh(GOOD)
    ready_s = time.monotonic() - began
    at_ready = show()
    now = until(streaming, 20)
    return {"code": code, "ready_s": ready_s, "at_ready": at_ready, "now": now, "process": process(now["MainPID"])}


def killed() -> dict[str, Any]:
    before = show()
    os.kill(int(before["MainPID"]), signal.SIGKILL)
    after = until(lambda now: streaming(now) and now["NRestarts"] == "1", 20)
    return {"before": before, "after": after}


def reloads() -> dict[str, Any]:
    before = show()
    CONFIG.write_text("profile: slow\n" + GOOD)
    bad = sh("systemctl", "reload", UNIT)
    refused = until(lambda now: "rejected" in now["StatusText"], 10)
    still = until(lambda now: streaming(now) and "rejected" in now["StatusText"], 10)
    CONFIG.write_text(GOOD)
    sh("systemctl", "reload", UNIT)
    good = until(lambda now: streaming(now) and "rejected" not in now["StatusText"], 10)
    return {"before": before, "bad": bad, "refused": refused, "still": still, "good": good}


def hangs() -> dict[str, Any]:
    """The thread `reconstruct` alone, in whatever it does: the last that a start makes (architecture.md)."""
    fresh(GOOD)
    before = show()
    last = threads(before["MainPID"])[-1]
    until(streaming, 20)
    began = time.monotonic()
    with frozen(last):
        without = until(lambda now: now["StatusText"] == "streaming, 0.0 frames/s", 8)
        killed = until(lambda now: now["NRestarts"] != before["NRestarts"], 30)
    after = until(streaming, 20)
    seen = {"before": before, "without": without, "killed": killed, "after": after, "journal": journal()}
    return {"seconds": time.monotonic() - began, **seen}


def works_a_while() -> dict[str, Any]:
    """Longer than the watchdog's time, so that only its feeding keeps it."""
    before = show()
    time.sleep(1.2 * WATCHDOG_S)
    now = show()
    return {"before": before, "now": now, "process": process(now["MainPID"])}


def stops() -> dict[str, Any]:
    began = time.monotonic()
    code = sh("systemctl", "stop", UNIT)[0]
    return {"code": code, "seconds": time.monotonic() - began, "now": show()}


def camera_is_absent() -> dict[str, Any]:
    code = fresh("source: {kind: v4l2, device: /dev/video99}\n")
    before = show()
    time.sleep(1.2 * WATCHDOG_S)
    return {"code": code, "before": before, "now": show()}


def configuration_is_bad() -> dict[str, Any]:
    code = fresh("profile: slow\n" + GOOD)
    failed = until(lambda now: now["ActiveState"] == "failed", 10)
    time.sleep(3)  # three times RestartSec
    return {"code": code, "failed": failed, "later": show()}


def main() -> None:
    tell(
        *(install, starts, killed, reloads, works_a_while, hangs, stops),
        *(camera_is_absent, configuration_is_bad, uninstalls),
    )


if __name__ == "__main__":
    main()
