#!/usr/bin/python3
"""Runs as root under a booted systemd without a network: lives with the Debian package as a person would, prints JSON.

Only what was seen is printed; test_package.py judges. Standard library only.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

from support.booted_service import CONFIG, UNIT, fresh, process, sh, show, streaming, tell, until

SETTINGS = "# mine\nsource: {kind: simulated, fps: 5}\n"
STATE = Path("/var/lib/tacshade-edge")
BY_HAND = Path("/usr/local/lib/systemd/system") / UNIT
# What a purged package may leave behind nothing of.
PLACES = ("/opt", "/etc/mosquitto", "/etc/tacshade-edge", "/etc/systemd/system", "/usr/lib/udev/rules.d", "/usr/bin")


def files() -> list[str]:
    found = (path for place in PLACES for path in Path(place).rglob("*") if path.is_file() or path.is_symlink())
    return sorted(str(path) for path in (*found, *Path("/usr/lib").glob("s*/**/tacshade-edge*")))


def apt(*words: str) -> tuple[int, str]:
    options = ("--no-install-recommends", "-o", "Dpkg::Options::=--force-confold")
    return sh("apt-get", "-qq", *options, *words, DEBIAN_FRONTEND="noninteractive")


def calibration() -> dict[str, str]:
    """Every one in the service's own folder."""
    return {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in STATE.rglob("*.npz")}


def installs() -> dict[str, Any]:
    before = files()
    BY_HAND.parent.mkdir(parents=True, exist_ok=True)
    BY_HAND.touch()
    beside = apt("install", "/payload/older.deb")
    BY_HAND.unlink()
    done = apt("install", "/payload/older.deb")
    verify = sh("systemd-analyze", "verify", f"/usr/lib/systemd/system/{UNIT}")
    config = CONFIG.stat()
    access = (
        config.st_uid,
        sh("id", "-g", "tacshade-edge")[1] == str(config.st_gid),
        oct(CONFIG.parent.stat().st_mode),
    )
    enabled = sh("systemctl", "is-enabled", UNIT)
    seen = {"before": before, "beside": beside, "done": done, "verify": verify, "access": access}
    return {**seen, "enabled": enabled, "now": show(), "version": sh("tacshade-edge", "--version")}


def starts() -> dict[str, Any]:
    owner = STATE.owner()  # a person calibrates before the first start
    sh("install", "-o", "tacshade-edge", "/payload/calibration.npz", str(STATE))
    code = fresh(SETTINGS)
    now = until(streaming, 20)
    seen = {"owner": owner, "code": code, "now": now, "process": process(now["MainPID"])}
    return {**seen, "calibration": calibration()}


def upgrades() -> dict[str, Any]:
    """Over the running service, to a package with other default settings."""
    before = show()
    done = apt("install", "/payload/newer.deb")
    now = until(streaming, 20)
    proposed = Path(f"{CONFIG}.dpkg-dist").exists()
    seen = {"before": before, "done": done, "now": now, "config": CONFIG.read_text(), "proposed": proposed}
    seen |= {"changed": sh("dpkg", "--verify", "tacshade-edge")[1], "version": sh("tacshade-edge", "--version")}
    return {**seen, "calibration": calibration(), "dropped": [path for path in files() if path.endswith("/dropped.py")]}


def refuses_a_second_installation() -> dict[str, Any]:
    return {"done": sh("/payload/systemd/install.sh")}


def removes() -> dict[str, Any]:
    """While it runs."""
    done = apt("remove", "tacshade-edge")
    left = [path for path in files() if "tacshade" in path]
    return {"done": done, "now": show(), "left": left, "config": CONFIG.read_text(), "calibration": calibration()}


def purges() -> dict[str, Any]:
    done = apt("purge", "tacshade-edge")
    left = {"files": files(), "etc": CONFIG.parent.exists(), "calibration": calibration()}
    return {"done": done, **left, "user": sh("id", "-un", "tacshade-edge")}


def main() -> None:
    tell(installs, starts, upgrades, refuses_a_second_installation, removes, purges)


if __name__ == "__main__":
    main()
