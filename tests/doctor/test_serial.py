from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path
from typing import Any

import pytest

from tacshade_edge.doctor.serial import check_serial

BY_ID = "/dev/serial/by-id/usb-FTDI_FT232R_A1-if00-port0"


def plug(machine: Any, port: str, **attributes: str) -> None:
    machine.put(f"/dev/{port}")
    machine.at(f"/sys/class/tty/{port}").mkdir(parents=True)
    for name, text in attributes.items():
        machine.put(f"/sys/class/tty/{port}/{name.replace('__', '/')}", text + "\n")


def test_no_port_is_no_fault(machine: Any) -> None:
    (finding,) = check_serial(machine)
    assert (finding.state, finding.fix) == ("ok", "")
    assert finding.found.startswith("found no serial port")


def test_terminals_and_places_without_a_chip_are_no_ports(machine: Any) -> None:
    for port in ("tty1", "ttyprintk", "tty"):
        plug(machine, port)
    plug(machine, "ttyS1", type="0")
    assert "found no serial port" in check_serial(machine)[0].found


def test_a_port_is_called_by_its_best_name(machine: Any) -> None:
    plug(machine, "ttyUSB0", device__latency_timer="1")
    machine.link("/dev/serial/by-path/platform-usb-0:1", "../../ttyUSB0")
    machine.link(BY_ID, "../../ttyUSB0")
    (finding,) = check_serial(machine)
    assert finding.state == "ok"
    assert finding.found == f"/dev/ttyUSB0, best named {BY_ID}: the port is free to use"


def test_a_port_is_no_problem_where_no_robot_is_configured(machine: Any) -> None:
    plug(machine, "ttyUSB0", device__latency_timer="16")
    machine.link(BY_ID, "../../ttyUSB0")
    (finding,) = check_serial(machine, None)
    assert finding.state == "ok"
    assert finding.found == (
        f"/dev/ttyUSB0, best named {BY_ID}: not checked, because the settings name no robot (serial: null)"
    )


def test_an_ftdi_chip_that_holds_bytes_back(machine: Any) -> None:
    plug(machine, "ttyUSB0", device__latency_timer="16")
    (finding,) = check_serial(machine)
    assert (finding.state, finding.found) == (
        "warning",
        "/dev/ttyUSB0: the port's chip holds bytes back for up to 16 ms",
    )
    assert finding.fix.startswith("echo 1 | sudo tee /sys/class/tty/ttyUSB0/device/latency_timer; ")


def test_another_program_and_a_console(machine: Any) -> None:
    plug(machine, "ttyACM0")
    plug(machine, "ttyS0", type="4")
    plug(machine, "ttyAMA0", type="32")
    plug(machine, "ttyAMA10")
    machine.link("/dev/serial0", "ttyAMA0")
    machine.put("/proc/cmdline", "console=serial0,115200 console=tty1 root=/dev/sda\n")
    machine.process(30, "/usr/sbin/ModemManager", holds="/dev/ttyACM0")
    machine.process(31, "/sbin/agetty", "-o", "-p", "115200", "ttyS0", "vt220", holds="/dev/ttyS0")
    findings = {finding.found.partition(":")[0]: finding for finding in check_serial(machine)}
    assert len(findings) == 4
    assert findings["/dev/ttyACM0"].found == "/dev/ttyACM0: in use by process 30 (ModemManager)"
    assert "kill 30" in findings["/dev/ttyACM0"].fix
    for port in ("ttyS0", "ttyAMA0"):
        assert "the system's console uses this port" in findings[f"/dev/{port}"].found
        assert f"serial-getty@{port}" in findings[f"/dev/{port}"].fix
    assert findings["/dev/ttyAMA10"].state == "ok"


@pytest.mark.skipif(os.geteuid() != 0, reason="needs root to become someone else")
def test_no_permission(machine: Any) -> None:
    root = Path(tempfile.mkdtemp())
    root.chmod(0o755)
    made = type(machine)(root)
    plug(made, "ttyUSB0")
    made.at("/dev/ttyUSB0").chmod(0o660)
    os.chown(made.at("/dev/ttyUSB0"), 0, 20)
    os.seteuid(65534)
    try:
        (finding,) = check_serial(made)
    finally:
        os.seteuid(0)
        shutil.rmtree(root)
    assert (finding.state, finding.found) == ("warning", "/dev/ttyUSB0: no permission")
    assert finding.fix == "sudo usermod -aG dialout nobody, then log out and in again"


def test_a_port_without_its_node(machine: Any) -> None:
    plug(machine, "ttyUSB3")
    machine.at("/dev/ttyUSB3").unlink()
    (finding,) = check_serial(machine)
    assert finding.state == "warning"
    assert finding.fix == "sudo udevadm trigger"


def test_the_robots_port_must_be_there(machine: Any) -> None:
    plug(machine, "ttyUSB0")
    missing, other = check_serial(machine, "/dev/ttyACM0")
    assert (missing.state, other.state) == ("fault", "ok")
    assert missing.found == "/dev/ttyACM0: no such device, although serial.device names it"
    for there in ("/dev/ttyUSB0", "socket://robot:7000"):
        assert [f.state for f in check_serial(machine, there)] == ["ok"]


def test_the_daemon_may_have_its_port(machine: Any) -> None:
    plug(machine, "ttyUSB0")
    machine.process(40, "/usr/bin/python3", "/opt/tacshade-edge/bin/tacshade-edge", "run", holds="/dev/ttyUSB0")
    assert [f.state for f in check_serial(machine, "/dev/ttyUSB0")] == ["ok"]
