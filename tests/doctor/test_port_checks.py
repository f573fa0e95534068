"""What cameras share on USB and whether it is enough, and who uses a serial port."""

from __future__ import annotations

from typing import Any

import pytest

from support.findings import checked, states
from tacshade_edge.doctor.port_checks import (
    Port,
    bytes_s,
    check_serial,
    check_usb,
    judge_usb,
    port_of,
)
from tacshade_edge.settings import V4l2

USB1, USB2, USB3 = (
    Port("USB bus 1", 12),
    Port("USB bus 1, port 1", 480),
    Port("USB bus 2, port 1", 5000),
)
BY_ID = "/dev/serial/by-id/usb-FTDI_FT232R_A1-if00-port0"


def camera(
    fourcc: str = "YUYV", width_px: int = 640, height_px: int = 480, fps: int = 30, device: int = 0
) -> V4l2:
    made: Any = {"fourcc": fourcc, "width_px": width_px, "height_px": height_px, "fps": fps}
    return V4l2(device=f"/dev/video{device}", **made)


def plug_camera(
    machine: Any, node: int, path: str, speed: str = "480", driver: str = "xhci_hcd"
) -> None:
    """A video node at a path such as 1-1.2, below a controller's root hub."""
    bus, controller = path.partition("-")[0], "/sys/devices/pci0/0000:01:00.0"
    folder = f"{controller}/usb{bus}/{path.partition('.')[0]}"
    folder = folder if "." not in path else f"{folder}/{path}"
    machine.put(f"/dev/video{node}")
    machine.put(f"{controller}/usb{bus}/speed", "480\n")
    machine.put(f"{folder}/speed", f"{speed}\n")
    machine.put(f"{folder}/{path}:1.0/video4linux/video{node}/name", "camera\n")
    machine.put(f"/sys/bus/pci/drivers/{driver}/bind")
    if not machine.at(f"{controller}/driver").exists():
        machine.link(f"{controller}/driver", f"../../../bus/pci/drivers/{driver}")
    machine.link(f"/sys/class/video4linux/video{node}/device", f"../../../..{folder}/{path}:1.0")


@pytest.mark.parametrize(
    ("cameras", "port", "state", "each_bytes_s"),
    [
        ([camera()] * 2, USB2, "ok", 18_432_000),
        ([camera()] * 3, USB2, "fault", 18_432_000),
        ([camera("MJPG")] * 5, USB2, "ok", 2_304_000),
        ([camera("GREY", fps=60)], USB2, "ok", 18_432_000),
        ([camera(fps=60)], USB2, "fault", 36_864_000),
        ([camera()] * 5, USB3, "ok", 18_432_000),
        ([camera("MJPG", 1280, 720, 60)] * 5, USB2, "warning", 13_824_000),
        ([camera("MJPG", 160, 120)], USB1, "ok", 144_000),
        ([camera("MJPG")], USB1, "warning", 2_304_000),
    ],
    ids=lambda value: f"{len(value)} x {value[0].fourcc}" if isinstance(value, list) else None,
)
def test_what_fits_through_a_port(
    cameras: list[V4l2], port: Port, state: str, each_bytes_s: float
) -> None:
    assert bytes_s(cameras[0]) == each_bytes_s
    assert states([judge_usb(port, cameras)]) == [state]


def test_what_would_fit_is_reported() -> None:
    five = judge_usb(USB2, [camera(device=k) for k in range(5)])
    assert "about 92 of 49 MB/s" in five.found
    assert "source.fps to at most 16" in five.fix
    one = judge_usb(USB2, [camera(fps=60)])
    assert one.found.endswith("one camera alone gets at most 25")


@pytest.mark.parametrize(
    ("paths", "driver", "names"),
    [
        (("1-1.1", "1-1.2", "1-2"), "xhci_hcd", ["USB bus 1, port 1", "USB bus 1, port 2"]),
        (("1-1", "1-2"), "ehci-pci", ["USB bus 1"]),  # one bus for all ports
    ],
)
def test_cameras_behind_one_port_are_counted_together(
    machine: Any, paths: tuple[str, ...], driver: str, names: list[str]
) -> None:
    for k, path in enumerate(paths):
        plug_camera(machine, 2 * k, path, driver=driver)
    found = check_usb([camera(device=2 * k) for k in range(len(paths))], machine)
    assert [finding.found.partition(" (")[0] for finding in found] == names


def test_a_stable_name_is_followed_and_what_is_not_on_usb_is_not_counted(machine: Any) -> None:
    plug_camera(machine, 0, "2-1.3", speed="5000")
    machine.link("/dev/v4l/by-id/usb-thumb-index0", "../../video0")
    assert port_of("/dev/v4l/by-id/usb-thumb-index0", machine) == USB3
    machine.put("/dev/video1")
    machine.put("/sys/devices/platform/unicam/video4linux/video1/name", "unicam")
    machine.link("/sys/class/video4linux/video1/device", "../../../devices/platform/unicam")
    assert check_usb([camera(device=1), camera(device=7)], machine) == ()


def plug(machine: Any, port: str, **attributes: str) -> None:
    machine.put(f"/dev/{port}")
    machine.at(f"/sys/class/tty/{port}").mkdir(parents=True)
    for name, text in attributes.items():
        machine.put(f"/sys/class/tty/{port}/{name.replace('__', '/')}", text + "\n")


def test_terminals_and_places_without_a_chip_are_no_ports(machine: Any) -> None:
    for port in ("tty1", "ttyprintk", "tty"):
        plug(machine, port)
    plug(machine, "ttyS1", type="0")
    (finding,) = checked(check_serial(machine))
    assert finding.state == "ok"
    assert "/dev" not in finding.found


@pytest.mark.parametrize(
    ("timer_ms", "device", "found", "fix"),
    [
        ("1", "", ["ok"], ""),
        ("16", "", ["warning"], "echo 1 | sudo tee /sys/class/tty/ttyUSB0/device/latency_timer"),
        ("16", None, ["ok"], ""),  # no robot is configured
        ("1", "/dev/ttyUSB0", ["ok"], ""),
        ("1", "socket://robot:7000", ["ok"], ""),
        ("1", "/dev/ttyACM0", ["fault", "ok"], "plug the robot in"),
    ],
)
def test_a_port_by_its_best_name(
    machine: Any, timer_ms: str, device: str | None, found: list[str], fix: str
) -> None:
    plug(machine, "ttyUSB0", device__latency_timer=timer_ms)
    machine.link("/dev/serial/by-path/platform-usb-0:1", "../../ttyUSB0")
    machine.link(BY_ID, "../../ttyUSB0")
    findings = check_serial(machine, device)
    assert states(findings) == found
    assert findings[-1].found.startswith(f"/dev/ttyUSB0, best named {BY_ID}: ")
    assert fix in findings[0].fix


def test_another_program_a_console_and_the_daemon(machine: Any) -> None:
    plug(machine, "ttyACM0")
    plug(machine, "ttyS0", type="4")
    plug(machine, "ttyAMA0", type="32")
    plug(machine, "ttyAMA10")
    machine.link("/dev/serial0", "ttyAMA0")
    machine.put("/proc/cmdline", "console=serial0,115200 console=tty1 root=/dev/sda\n")
    machine.process(30, "/usr/sbin/ModemManager", holds="/dev/ttyACM0")
    machine.process(31, "/sbin/agetty", "-o", "-p", "115200", "ttyS0", "vt220", holds="/dev/ttyS0")
    machine.process(
        40, "/usr/bin/python3", "/opt/tacshade-edge/bin/tacshade-edge", "run", holds="/dev/ttyAMA10"
    )
    fixes = {
        finding.found.partition(":")[0]: finding.fix for finding in checked(check_serial(machine))
    }
    for port, fix in (
        ("ttyACM0", "kill 30"),
        ("ttyS0", "serial-getty@ttyS0"),
        ("ttyAMA0", "serial-getty@ttyAMA0"),
    ):
        assert fix in fixes.pop(f"/dev/{port}")
    assert fixes == {"/dev/ttyAMA10": ""}
