"""What a scenario under a booted systemd uses to watch the service as a person would.

Standard library only.
"""

from __future__ import annotations

import ctypes
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Thread
from typing import Any

from support.patience import patience

UNIT = "tacshade-edge.service"
CONFIG = Path("/etc/tacshade-edge/config.yaml")
PROPERTIES = (
    "LoadState,ActiveState,SubState,Result,MainPID,NRestarts,ExecMainStatus,StatusText,"
    "MemoryMax,MemoryCurrent,UID,WatchdogUSec,WatchdogTimestampMonotonic"
)
PTRACE_SEIZE, PTRACE_INTERRUPT, PTRACE_DETACH, WALL = 0x4206, 0x4207, 17, 0x40000000


def sh(*command: str, **environment: str) -> tuple[int, str]:
    """Exit code and output."""
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )
    return done.returncode, (done.stdout + done.stderr).strip()


def show() -> dict[str, str]:
    lines = sh("systemctl", "show", UNIT, f"--property={PROPERTIES}")[1].splitlines()
    return dict(line.split("=", 1) for line in lines)


def until(condition: Callable[[dict[str, str]], bool], seconds: float) -> dict[str, str]:
    """The service's properties when the condition holds, or after so long on this machine:
    the judge sees which.
    """
    began = time.monotonic()
    deadline = began + patience(seconds)
    while not condition(now := show()) and time.monotonic() < deadline:
        time.sleep(
            max(0.1, time.monotonic() - began)
        )  # emulated, a look takes a core most of a second
        began = time.monotonic()
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


def journal() -> str:
    return sh("journalctl", "--unit", UNIT, "--output=cat", "--no-pager")[1]


def report(*steps: Callable[[], object]) -> None:
    """Take the steps; what each saw, and the journal,
    to /payload/seen.json for the tests that judge.
    """
    seen: dict[str, Any] = {}
    for step in steps:
        began = time.monotonic()
        seen[step.__name__] = step()
        print(f"{step.__name__}: {time.monotonic() - began:.1f} s", flush=True)
    seen["journal"] = journal()
    Path("/payload/seen.json").write_text(json.dumps(seen))


def threads(pid: str) -> list[int]:
    """Of a process, in the order in which they were made."""
    return sorted(int(path.name) for path in Path(f"/proc/{pid}/task").iterdir())


@contextmanager
def frozen(thread: int) -> Iterator[None]:
    """One thread of another process stands still, as if it hung in a library; all others go on."""
    libc = ctypes.CDLL(None, use_errno=True)

    def ptrace(request: int) -> None:
        if libc.ptrace(request, thread, None, None) < 0:
            raise OSError(ctypes.get_errno(), f"ptrace {request:#x} of {thread}")

    ptrace(PTRACE_SEIZE)
    ptrace(PTRACE_INTERRUPT)
    os.waitpid(thread, WALL)
    # Its death must be collected at once, or the process stays a zombie.
    Thread(target=os.waitpid, args=(thread, WALL), daemon=True).start()
    try:
        yield
    finally:
        with suppress(OSError):  # killed meanwhile
            ptrace(PTRACE_DETACH)
