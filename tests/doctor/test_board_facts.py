"""A report that is sent in says what the board is, and nothing of whose it is."""

from __future__ import annotations

import getpass
import platform
import socket
from typing import Any

import pytest

from tacshade_edge.doctor.board_facts import MODEL, THROTTLED, board_facts, heat

SECRETS = ("10000000abcdef01", "somebodys-hand", "dc:a6:32:01:02:03")


def test_a_raspberry_pi(machine: Any) -> None:
    machine.put(MODEL, "Raspberry Pi 5 Model B Rev 1.0\0")
    machine.put("/proc/device-tree/serial-number", f"{SECRETS[0]}\0")
    machine.put("/proc/cpuinfo", f"processor\t: 0\nCPU part\t: 0xd0b\n\nSerial\t\t: {SECRETS[0]}\nModel\t\t: Pi\n")
    machine.put("/proc/meminfo", "MemTotal:        8245424 kB\n")
    machine.put("/etc/hostname", f"{SECRETS[1]}\n")
    machine.put("/etc/os-release", 'PRETTY_NAME="Debian GNU/Linux 12 (bookworm)"\nNAME="Debian"\n')
    machine.put("/sys/class/net/eth0/address", f"{SECRETS[2]}\n")
    machine.put("/sys/devices/system/cpu/cpu0/cpufreq/cpuinfo_max_freq", "2400000\n")
    facts = board_facts(machine)
    assert facts["board"] == "Raspberry Pi 5 Model B Rev 1.0"
    assert facts["processor"] == "Cortex-A76"
    assert facts["cores"].endswith(", up to 2400 MHz")
    assert (facts["memory"], facts["system"]) == ("7.9 GiB", "Debian GNU/Linux 12 (bookworm)")
    said = "\n".join(facts.values())
    assert [secret for secret in (*SECRETS, socket.gethostname()) if secret in said] == []
    assert getpass.getuser() not in said.split()


def test_a_machine_that_tells_nothing(machine: Any) -> None:
    facts = board_facts(machine)
    assert facts["board"] == f"{platform.machine()} machine"
    assert set(facts) == {"board", "cores", "kernel", "Python", "tacshade-edge"}
    assert heat(machine) == ""


def test_what_would_break_the_table_or_the_line(machine: Any) -> None:
    machine.put(MODEL, "a | b\nc\x1b[31m" + "d" * 200)
    board = board_facts(machine)["board"]
    assert board.startswith("a / b\\nc\\x1b[31md")
    assert len(board) < 100


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ("0", "61 °C, never throttled since boot"),
        ("50005", "61 °C, under-voltage and throttled since boot"),
        ("80000", "61 °C, hot since boot"),
    ],
)
def test_heat(machine: Any, flags: str, said: str) -> None:
    for zone, (kind, millidegrees) in enumerate((("cpu-thermal", 61200), ("rp1_adc", 80000))):
        machine.put(f"/sys/class/thermal/thermal_zone{zone}/type", kind)
        machine.put(f"/sys/class/thermal/thermal_zone{zone}/temp", str(millidegrees))
    machine.put(THROTTLED, flags)
    assert heat(machine) == said
