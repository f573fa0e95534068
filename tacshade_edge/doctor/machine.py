"""Devices and processes in the kernel's file systems;
the root is an argument, so that tests can build one.
"""

from __future__ import annotations

import grp
import os
import pwd
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

AS_SERVICE = "sudo -u tacshade-edge /opt/tacshade-edge/bin/tacshade-edge doctor"


@dataclass(frozen=True, slots=True)
class Process:
    pid: int
    words: tuple[str, ...]

    def __str__(self) -> str:
        command = " ".join(os.path.basename(word) for word in self.words)
        return f"process {self.pid} ({command[:60] or 'no name'})"


@dataclass(frozen=True, slots=True)
class Machine:
    """The machine below `root`, which has dev, proc and sys."""

    root: Path = Path("/")

    def at(self, path: str) -> Path:
        """The absolute `path` on this machine."""
        return self.root / path.lstrip("/")

    def name_of(self, path: Path) -> str:
        """The path as the machine's users see it, without `root`."""
        return f"/{path.relative_to(self.root)}"

    def read(self, path: str) -> str:
        """The stripped text of a file; empty if it is missing or unreadable."""
        try:
            # Files of sysfs exist and yet fail to be read, as with EIO while a device goes away.
            return self.at(path).read_text(errors="replace").strip()
        except OSError:
            return ""

    def names(self, folder: str, pattern: str = "*") -> list[Path]:
        """The paths in a folder, shorter names first, then by name; empty if there is no folder."""
        # video2 comes before video10.
        return sorted(self.at(folder).glob(pattern), key=lambda path: (len(path.name), path.name))

    def processes(self) -> list[Process]:
        """Every visible process except this one."""
        # Without itself: this process may hold the camera that it asks about.
        numbers = [
            int(folder.name)
            for folder in self.names("/proc", "[0-9]*")
            if int(folder.name) != os.getpid()
        ]
        return [
            Process(n, tuple(self.read(f"/proc/{n}/cmdline").rstrip("\0").split("\0")))
            for n in numbers
        ]

    def holders(self, device: str) -> list[Process]:
        """The other processes that have a device open,
        as far as this user can see (root sees all).
        """
        target = os.path.realpath(self.at(device))
        return [process for process in self.processes() if self._holds(process, target)]

    def _holds(self, process: Process, target: str) -> bool:
        try:
            return any(
                os.readlink(fd) == target for fd in self.at(f"/proc/{process.pid}/fd").iterdir()
            )
        # The process has ended, or belongs to another user.
        except OSError:
            return False

    def daemon(self, pid: int | None = None) -> Process | None:
        """The process of ``tacshade-edge run`` on this machine, of several that with number `pid`,
        else the first; None if none runs.
        """
        running = [process for process in self.processes() if _is_daemon(process)]
        return next((one for one in running if one.pid == pid), next(iter(running), None))


def _is_daemon(process: Process) -> bool:
    # The program may follow `python -m`, or an interpreter of its own.
    return any(
        os.path.basename(program) in ("tacshade-edge", "tacshade_edge") and command == "run"
        for program, command in pairwise(process.words[:4])
    )


def may_use(path: Path) -> bool:
    # By default os.access asks for the real user, as whom nothing is opened.
    return os.access(path, os.R_OK | os.W_OK, effective_ids=True)


def permission_fix(path: Path, usual_group: str) -> str:
    """Return the command or the step that gives this user access to the device."""
    try:
        group = grp.getgrgid(path.stat().st_gid).gr_name
    except KeyError:
        group = usual_group
    # No group to join: the rules of udev are missing.
    if group == "root":
        return "install the udev rules (systemd/install.sh does so), then plug the device in again"
    return (
        f"sudo usermod -aG {group} {pwd.getpwuid(os.geteuid()).pw_name}, then log out and in again"
    )
