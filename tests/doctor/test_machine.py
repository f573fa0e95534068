from __future__ import annotations

import getpass
import os
import pty
import shutil
import tempfile
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.doctor.machine import Machine, may_use, permission_fix


def test_who_holds_a_device_by_any_of_its_names(machine: Any) -> None:
    machine.put("/dev/video0")
    machine.link("/dev/v4l/by-id/cam", "../../video0")
    machine.process(20, "/usr/bin/cheese", "--wide", holds="/dev/video0")
    machine.process(21, "/bin/sh", holds="/dev/other")
    for name in ("/dev/video0", "/dev/v4l/by-id/cam"):
        assert [str(holder) for holder in machine.holders(name)] == ["process 20 (cheese --wide)"]
    assert machine.holders("/dev/other") != []
    assert machine.holders("/dev/absent") == []


def test_this_process_is_no_holder_of_its_own() -> None:
    first, second = pty.openpty()
    try:
        assert os.getpid() not in [holder.pid for holder in Machine().holders(os.ttyname(second))]
    finally:
        os.close(first)
        os.close(second)


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (("/opt/tacshade-edge/bin/python", "/opt/tacshade-edge/bin/tacshade-edge", "run"), True),
        (("python3", "-m", "tacshade_edge", "run", "--config", "a.yaml"), True),
        (("tacshade-edge", "doctor", "--config", "run"), False),
        (("/bin/sh", "-c", "tacshade-edge run"), False),
        (("",), False),
    ],
)
def test_the_daemon_is_told_from_other_commands(machine: Any, words: tuple[str, ...], found: bool) -> None:
    machine.process(7, *words)
    daemon = machine.daemon()
    assert (daemon is not None and daemon.pid == 7) is found


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become someone else")
def test_permission_is_that_of_the_user_who_asks() -> None:
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    device = folder / "device"
    device.touch()
    device.chmod(0o600)
    assert may_use(device)
    os.seteuid(65534)
    try:
        assert not may_use(device)
    finally:
        os.seteuid(0)
        shutil.rmtree(folder)


def test_the_fix_names_the_devices_group_and_the_user(tmp_path: Path) -> None:
    device = tmp_path / "device"
    device.touch()
    if os.geteuid() == 0:
        os.chown(device, 0, 20)
        assert (
            permission_fix(device, "dialout")
            == f"sudo usermod -aG dialout {getpass.getuser()}, then log out and in again"
        )
        os.chown(device, 0, 54321)
        assert "usermod -aG video " in permission_fix(device, "video"), "a group without a name: the usual one"
        os.chown(device, 0, 0)
        assert "udev" in permission_fix(device, "video"), "nobody should join root"
    else:
        assert getpass.getuser() in permission_fix(device, "dialout")
