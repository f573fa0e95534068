from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from tacshade_edge.demo.child import Child, free_port, wait_for_port
from tacshade_edge.errors import DeviceError
from tools.testbed.patience import wait_until


def gone(pid: int) -> bool:
    """Dead, or dead and not yet collected by whoever inherited it."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except FileNotFoundError:
        return True


def test_a_child_that_ends_is_told_with_its_last_line(tmp_path: Path) -> None:
    child = Child("broker", ["sh", "-c", "echo first; echo; echo no room >&2; echo; exit 3"], tmp_path)
    with pytest.raises(DeviceError, match=r"^demo: the broker exited with status 3: no room$"):
        wait_for_port(child, free_port(), 20)
    child.stop()
    assert "first" in child.output


def test_a_child_that_does_not_listen_is_told(tmp_path: Path) -> None:
    child, port = Child("daemon", ["sleep", "60"], tmp_path), free_port()
    with pytest.raises(DeviceError, match=rf"^demo: the daemon did not listen on port {port} within 0 s$"):
        wait_for_port(child, port, 0.0)
    child.stop()
    with pytest.raises(DeviceError, match="exited with status -15: no output"):
        child.check()


def test_waiting_ends_when_the_port_is_open(tmp_path: Path) -> None:
    child = Child("dashboard", ["sleep", "60"], tmp_path)
    with socket.create_server(("127.0.0.1", 0)) as server:
        wait_for_port(child, server.getsockname()[1], 5)
    child.check()
    child.stop()


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's death signal is Linux's")
def test_a_killed_demo_leaves_no_child(tmp_path: Path) -> None:
    program = f"""
from pathlib import Path
from tacshade_edge.demo.child import Child
child = Child("daemon", ["sh", "-c", "echo $$; exec sleep 60"], Path({str(tmp_path)!r}))
while not child.output.strip():
    pass
print(child.output, flush=True)
input()
"""
    parent = subprocess.Popen([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    assert not gone(pid)
    os.kill(parent.pid, signal.SIGKILL)
    wait_until(lambda: gone(pid), 10, "the child is gone")
    parent.communicate()
