#!/usr/bin/python3
"""Runs as root under a booted systemd (tools/rig/boot_systemd.sh): uses the service as a person would, prints JSON.

Only what was seen is printed; test_boot.py judges. Standard library only.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

UNIT = "tacshade-edge.service"
CONFIG = Path("/etc/tacshade-edge/config.yaml")
APP = Path("/opt/tacshade-edge")
GOOD = "source: {kind: simulated}\n"
PROPERTIES = (
    "ActiveState,SubState,Result,MainPID,NRestarts,ExecMainStatus,StatusText,MemoryMax,MemoryCurrent,UID,WatchdogUSec"
)


def sh(*command: str) -> tuple[int, str]:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, (done.stdout + done.stderr).strip()


def show() -> dict[str, str]:
    lines = sh("systemctl", "show", UNIT, f"--property={PROPERTIES}")[1].splitlines()
    return dict(line.split("=", 1) for line in lines)


def until(condition: Callable[[dict[str, str]], bool], seconds: float) -> dict[str, str]:
    """The service's properties when the condition holds, or at the deadline: the judge sees which."""
    deadline = time.monotonic() + seconds
    while not condition(now := show()) and time.monotonic() < deadline:
        time.sleep(0.1)
    return now


def streaming(now: dict[str, str]) -> bool:
    return now["ActiveState"] == "active" and now["StatusText"].startswith("streaming")


def fresh(config: str) -> int:
    """Stop, forget the past, start with these settings; the exit code of the start."""
    sh("systemctl", "stop", UNIT)
    sh("systemctl", "reset-failed", UNIT)
    CONFIG.write_text(config)
    return sh("systemctl", "start", UNIT)[0]


def process(pid: str) -> dict[str, str]:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return dict(line.split(":\t", 1) for line in lines if ":\t" in line)


def install() -> dict[str, Any]:
    """The shipped files through install.sh; the program from what the tests run with, as pip would lay it out."""
    code, output = sh("env", "DESTDIR=/", "/payload/checkout/systemd/install.sh")
    version = f"python{sys.argv[1]}"
    site = APP / "lib" / version / "site-packages"
    site.mkdir(parents=True)
    shutil.copytree("/payload/checkout/tacshade_edge", site / "tacshade_edge")
    (site / "dependencies.pth").write_text("/opt/site-packages\n")
    (APP / "bin").mkdir()
    (APP / "bin/python").symlink_to(f"/opt/python/bin/{version}")
    (APP / "pyvenv.cfg").write_text("home = /opt/python/bin\n")
    script = APP / "bin/tacshade-edge"
    script.write_text(f"#!{APP}/bin/python\nfrom tacshade_edge.cli import main\nraise SystemExit(main())\n")
    script.chmod(0o755)
    # A Python below /root names its library there, where the unit must not look.
    Path("/etc/ld.so.conf.d/00-python.conf").write_text("/opt/python/lib\n")
    sh("ldconfig")
    users = sh("systemd-sysusers", "/usr/local/lib/sysusers.d/tacshade-edge.conf")
    sh("chgrp", "-R", "tacshade-edge", str(CONFIG.parent))
    state = Path("/var/lib/tacshade-edge")
    state.mkdir()
    shutil.copy("/payload/calibration.npz", state)
    shutil.chown(state / "calibration.npz", "tacshade-edge")
    shutil.chown(state, "tacshade-edge")
    sh("systemctl", "daemon-reload")
    verify = sh("systemd-analyze", "verify", f"/usr/local/lib/systemd/system/{UNIT}")
    return {"code": code, "output": output, "users": users, "verify": verify}


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
    refused = until(lambda now: "refused" in now["StatusText"], 10)
    still = until(lambda now: streaming(now) and "refused" in now["StatusText"], 10)
    CONFIG.write_text(GOOD)
    sh("systemctl", "reload", UNIT)
    good = until(lambda now: streaming(now) and "refused" not in now["StatusText"], 10)
    return {"before": before, "bad": bad, "refused": refused, "still": still, "good": good}


def hangs() -> dict[str, Any]:
    before = show()
    began = time.monotonic()
    os.kill(int(before["MainPID"]), signal.SIGSTOP)
    after = until(lambda now: streaming(now) and now["NRestarts"] != before["NRestarts"], 40)
    journal = sh("journalctl", "--unit", UNIT, "--output=cat", "--no-pager")[1]
    return {"before": before, "after": after, "seconds": time.monotonic() - began, "journal": journal}


def works_a_while() -> dict[str, Any]:
    """Longer than the watchdog's time, so that only its feeding keeps it."""
    before = show()
    time.sleep(15)
    now = show()
    return {"before": before, "now": now, "process": process(now["MainPID"])}


def stops() -> dict[str, Any]:
    began = time.monotonic()
    code = sh("systemctl", "stop", UNIT)[0]
    return {"code": code, "seconds": time.monotonic() - began, "now": show()}


def camera_is_absent() -> dict[str, Any]:
    code = fresh("source: {kind: v4l2, device: /dev/video99}\n")
    before = show()
    time.sleep(15)
    return {"code": code, "before": before, "now": show()}


def configuration_is_bad() -> dict[str, Any]:
    code = fresh("profile: slow\n" + GOOD)
    failed = until(lambda now: now["ActiveState"] == "failed", 10)
    time.sleep(3)  # three times RestartSec
    return {"code": code, "failed": failed, "later": show()}


def main() -> None:
    steps = (install, starts, killed, reloads, hangs, works_a_while, stops, camera_is_absent, configuration_is_bad)
    seen: dict[str, Any] = {}
    for step in steps:
        began = time.monotonic()
        seen[step.__name__] = step()
        print(f"{step.__name__}: {time.monotonic() - began:.1f} s", flush=True)
    seen["journal"] = sh("journalctl", "--unit", UNIT, "--output=cat", "--no-pager")[1]
    Path("/payload/seen.json").write_text(json.dumps(seen))


if __name__ == "__main__":
    main()
