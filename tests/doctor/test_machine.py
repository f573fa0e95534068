"""Power, heat, governor, clocks and disk; and that a report says what the board is,
and nothing of whose it is.
"""

from __future__ import annotations

import getpass
import os
import socket
from pathlib import Path
from typing import Any

import pytest

from support.findings import checked, states
from tacshade_edge.doctor.board import (
    MODEL,
    THROTTLED,
    board_facts,
    check_board,
    check_clock,
    check_disk,
    heat,
    judge_clock,
    judge_disk,
    synchronised,
)
from tacshade_edge.doctor.machine import permission_fix


def test_who_holds_a_device_by_any_of_its_names(machine: Any) -> None:
    machine.put("/dev/video0")
    machine.link("/dev/v4l/by-id/cam", "../../video0")
    machine.process(20, "/usr/bin/cheese", "--wide", holds="/dev/video0")
    machine.process(21, "/bin/sh", holds="/dev/other")
    for name in ("/dev/video0", "/dev/v4l/by-id/cam"):
        assert [str(holder) for holder in machine.holders(name)] == ["process 20 (cheese --wide)"]
    assert machine.holders("/dev/other") != []
    assert machine.holders("/dev/absent") == []


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
def test_the_daemon_is_distinguished_from_other_commands(
    machine: Any, words: tuple[str, ...], found: bool
) -> None:
    machine.process(7, *words)
    daemon = machine.daemon()
    assert (daemon is not None and daemon.pid == 7) is found


def test_of_several_daemons_the_one_that_is_named_is_found(machine: Any) -> None:
    for pid in (7, 8, 9):
        machine.process(pid, *(("tacshade-edge", "run") if pid != 9 else ("sh",)))
    found = [machine.daemon(pid) for pid in (8, 9, None)]
    assert [each.pid for each in found] == [8, 7, 7]


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
        assert "usermod -aG video " in permission_fix(device, "video"), (
            "a group without a name: the usual one"
        )
        os.chown(device, 0, 0)
        assert "udev" in permission_fix(device, "video"), "nobody should join root"
    else:
        assert getpass.getuser() in permission_fix(device, "dialout")


CPU = "/sys/devices/system/cpu/cpu0/cpufreq"
SECRETS = ("10000000abcdef01", "somebodys-hand", "dc:a6:32:01:02:03")
NOW_S, INSTALLED_S = 1_800_000_000.0, 1_790_000_000.0


@pytest.mark.parametrize(
    ("files", "found", "words"),
    [
        ({}, [], []),
        ({THROTTLED: "0"}, ["ok"], ["fine"]),
        (
            {THROTTLED: "50000"},
            ["warning", "warning"],
            ["under-voltage at some time", "slowed down at some time"],
        ),
        (
            {THROTTLED: "50001"},
            ["warning", "warning"],
            ["under-voltage now", "slowed down at some time"],
        ),
        ({THROTTLED: "80008"}, ["warning"], ["slowed down now"]),
        (
            {f"{CPU}/scaling_governor": "powersave", f"{CPU}/scaling_driver": "cpufreq-dt"},
            ["warning"],
            ["powersave"],
        ),
        ({f"{CPU}/scaling_governor": "ondemand", f"{CPU}/scaling_driver": "cpufreq-dt"}, [], []),
        ({f"{CPU}/scaling_governor": "powersave", f"{CPU}/scaling_driver": "intel_pstate"}, [], []),
    ],
)
def test_power_and_governor(
    machine: Any, files: dict[str, str], found: list[str], words: list[str]
) -> None:
    for path, text in files.items():
        machine.put(path, f"{text}\n")
    findings = check_board(machine)
    assert states(findings) == found
    assert all(word in finding.found for word, finding in zip(words, findings, strict=True))


@pytest.mark.parametrize(
    ("now_s", "synced", "state"),
    [(NOW_S, True, "ok"), (NOW_S, None, "ok"), (NOW_S, False, "warning"), (0.0, True, "fault")],
)
def test_clocks(now_s: float, synced: bool | None, state: str) -> None:
    assert states([judge_clock(now_s, INSTALLED_S, synced=synced)]) == [state]
    assert synchronised() in (True, False)
    assert states(check_clock())[0] in ("ok", "warning"), "this machine knows its year"


@pytest.mark.parametrize(
    ("free_bytes", "read_only", "state"),
    [
        (5_000_000_000, False, "ok"),
        (400_000_000, False, "warning"),
        (1_000_000, False, "fault"),
        (5_000_000_000, True, "fault"),
    ],
)
def test_disk(tmp_path: Path, free_bytes: int, read_only: bool, state: str) -> None:
    assert states([judge_disk(Path("/var/lib/x"), free_bytes, read_only=read_only)]) == [state]
    later = tmp_path / "a/b/c"
    assert str(later) in checked(check_disk(later))[0].found, "a folder that is not there yet"


def test_the_facts_name_the_board_and_not_its_owner(machine: Any) -> None:
    assert set(board_facts(machine)) == {"board", "cores", "kernel", "Python", "tacshade-edge"}, (
        "all that is reported"
    )
    assert heat(machine) == ""
    for path, text in {
        MODEL: "Raspberry Pi | 5\x1b[31m" + "d" * 200,
        "/proc/device-tree/serial-number": f"{SECRETS[0]}\0",
        "/proc/cpuinfo": (
            f"processor\t: 0\nCPU part\t: 0xd0b\n\nSerial\t\t: {SECRETS[0]}\nModel\t\t: Pi\n"
        ),
        "/proc/meminfo": "MemTotal:        8245424 kB\n",
        "/etc/hostname": f"{SECRETS[1]}\n",
        "/etc/os-release": 'PRETTY_NAME="Debian GNU/Linux 12 (bookworm)"\nNAME="Debian"\n',
        "/sys/class/net/eth0/address": f"{SECRETS[2]}\n",
        f"{CPU}/cpuinfo_max_freq": "2400000\n",
    }.items():
        machine.put(path, text)
    facts = board_facts(machine)
    assert facts["board"].startswith("Raspberry Pi / 5\\x1b[31md")
    assert len(facts["board"]) < 100
    assert facts["cores"].endswith(", up to 2400 MHz")
    known = ("Cortex-A76", "7.9 GiB", "Debian GNU/Linux 12 (bookworm)")
    assert tuple(facts[name] for name in ("processor", "memory", "system")) == known
    shown = "\n".join(facts.values())
    assert [secret for secret in (*SECRETS, socket.gethostname()) if secret in shown] == []
    assert getpass.getuser() not in shown.split()


@pytest.mark.parametrize(
    ("flags", "since_boot"),
    [("0", "never throttled"), ("50005", "under-voltage and throttled"), ("80000", "hot")],
)
def test_heat(machine: Any, flags: str, since_boot: str) -> None:
    for zone, (kind, millidegrees) in enumerate((("cpu-thermal", 61200), ("rp1_adc", 80000))):
        machine.put(f"/sys/class/thermal/thermal_zone{zone}/type", kind)
        machine.put(f"/sys/class/thermal/thermal_zone{zone}/temp", str(millidegrees))
    machine.put(THROTTLED, flags)
    assert heat(machine) == f"61 °C, {since_boot} since boot"
