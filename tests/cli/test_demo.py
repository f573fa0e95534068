from __future__ import annotations

import contextlib
import os
import pty
import re
import signal
import subprocess
import sys
from collections.abc import Sequence

import pytest

LINE = re.compile(r"^(no )?contact +depth +\d+\.\d\d mm \(pressed \d\.\d\d\)  \d objects?  +\d+\.\d fps  fast$")
COMMAND = [sys.executable, "-m", "tacshade_edge", "demo"]


def depths(lines: Sequence[str]) -> list[tuple[float, float]]:
    """Shown and pressed depth of every line."""
    found = [re.search(r"depth +(\d+\.\d\d) mm \(pressed (\d\.\d\d)\)", line) for line in lines]
    return [(float(m[1]), float(m[2])) for m in found if m]


@pytest.mark.slow
def test_in_a_pipe_it_prints_plain_lines_and_ends_by_itself() -> None:
    done = subprocess.run([*COMMAND, "--seconds", "3"], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    first, *lines, last = done.stdout.splitlines()
    assert first.startswith("Calibrating")
    assert re.fullmatch(r"\d+ frames, \d+ with contact, \d+ superseded", last)
    assert len(lines) >= 3
    assert all(LINE.match(line) for line in lines), lines
    # Plumbing, not accuracy: a busy machine drops frames, and then another object is held than the first.
    held = [shown for shown, pressed in depths(lines) if pressed == 3.0]
    free = [shown for shown, pressed in depths(lines) if pressed == 0.0]
    assert held
    assert all(shown > 0.5 for shown in held)
    assert free
    assert all(shown == 0.0 for shown in free)


def read_to_end(leader: int) -> bytes:
    shown = b""
    with contextlib.suppress(OSError):  # how a pty tells that the other side closed
        while chunk := os.read(leader, 65536):
            shown += chunk
    os.close(leader)
    return shown


@pytest.mark.slow
def test_on_a_terminal_it_redraws_a_map_until_ctrl_c() -> None:
    leader, follower = pty.openpty()
    child = subprocess.Popen(COMMAND, stdout=follower, stderr=subprocess.PIPE, text=True)
    os.close(follower)
    shown = b""
    while shown.count(b"\x1b[21A") < 5:  # moved up over the block
        shown += os.read(leader, 65536)
    child.send_signal(signal.SIGINT)
    shown += read_to_end(leader)
    _, errors = child.communicate(timeout=20)
    assert (child.returncode, errors) == (0, "")
    assert re.search(rb"\d+ frames, \d+ with contact, \d+ superseded\r\n$", shown)
    block = shown.decode().split("\x1b[21A")[2].replace("\x1b[K", "").splitlines()
    assert len(block) == 21
    assert all(set(line) <= set(" .:-=+*#%@") for line in block[:20])
    assert block[10].startswith(".")
