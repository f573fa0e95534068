"""What cameras share, and whether it is enough."""

from __future__ import annotations

from typing import Any

import pytest

from tacshade_edge.doctor.usb import Port, bytes_s, check_usb, judge, port_of
from tacshade_edge.settings import V4l2

USB2 = Port("USB bus 1, port 1", 480)
USB3 = Port("USB bus 2, port 1", 5000)


def camera(fourcc: str = "YUYV", width_px: int = 640, height_px: int = 480, fps: int = 30, device: int = 0) -> V4l2:
    return V4l2(
        device=f"/dev/video{device}",
        fourcc=fourcc,  # type: ignore[arg-type]
        width_px=width_px,
        height_px=height_px,
        fps=fps,
    )


def plug(machine: Any, node: int, path: str, speed: str = "480", driver: str = "xhci_hcd") -> None:
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
    ("source", "expected"),
    [(camera(), 18_432_000), (camera("GREY", fps=60), 18_432_000), (camera("MJPG"), 2_304_000)],
    ids=["YUYV", "GREY", "MJPG"],
)
def test_what_a_stream_takes(source: V4l2, expected: float) -> None:
    assert bytes_s(source) == expected


@pytest.mark.parametrize(
    ("cameras", "port", "state"),
    [
        ([camera()] * 2, USB2, "ok"),
        ([camera()] * 3, USB2, "fault"),
        ([camera("MJPG")] * 5, USB2, "ok"),
        ([camera("MJPG", fps=60)] * 5, USB2, "ok"),
        ([camera(width_px=320, height_px=240)] * 5, USB2, "ok"),
        ([camera(fps=60)], USB2, "fault"),
        ([camera()] * 5, USB3, "ok"),
        ([camera("MJPG", 1280, 720, 60)] * 5, USB2, "warning"),
        ([camera("MJPG", 160, 120)], Port("USB bus 1", 12), "ok"),
        ([camera("MJPG")], Port("USB bus 1", 12), "warning"),
    ],
    ids=lambda value: f"{len(value)} x {value[0].fourcc}" if isinstance(value, list) else None,
)
def test_what_fits_through_a_port(cameras: list[V4l2], port: Port, state: str) -> None:
    finding = judge(port, cameras)
    assert finding.state == state
    assert bool(finding.fix) == (state != "ok")


def test_five_yuyv_cameras_are_told_what_would_fit() -> None:
    finding = judge(USB2, [camera(device=k) for k in range(5)])
    assert finding.found == ("USB bus 1, port 1 (480 Mbit/s): 5 cameras with YUYV 640x480 at 30/s: about 92 of 49 MB/s")
    assert finding.fix == (
        "set source.fourcc: MJPG (12 MB/s); or set source.width_px: 320, height_px: 240, and calibrate at that size "
        "(23 MB/s); or set source.fps to at most 16; or plug some into ports of another controller"
    )


def test_one_camera_has_its_own_bound() -> None:
    finding = judge(USB2, [camera(fps=60)])
    assert finding.found.endswith("about 37 of 49 MB/s, but one camera alone gets at most 25")
    assert "another controller" not in finding.fix
    assert "set source.fps to at most 40" in finding.fix


def test_cameras_behind_one_port_are_counted_together_and_others_apart(machine: Any) -> None:
    plug(machine, 0, "1-1.1")
    plug(machine, 2, "1-1.2")
    plug(machine, 4, "1-2")
    findings = check_usb([camera(device=k) for k in (0, 2, 4)], machine)
    assert [f.found.partition(" with")[0] for f in findings] == [
        "USB bus 1, port 1 (480 Mbit/s): 2 cameras",
        "USB bus 1, port 2 (480 Mbit/s): 1 camera",
    ]


def test_a_controller_of_usb_2_has_one_bus_for_all_ports(machine: Any) -> None:
    plug(machine, 0, "1-1", driver="ehci-pci")
    plug(machine, 2, "1-2", driver="ehci-pci")
    (finding,) = check_usb([camera(device=0), camera(device=2)], machine)
    assert finding.found.startswith("USB bus 1 (480 Mbit/s): 2 cameras")


def test_a_stable_name_is_followed_and_the_camera_s_own_speed_is_read(machine: Any) -> None:
    plug(machine, 0, "2-1.3", speed="5000")
    machine.link("/dev/v4l/by-id/usb-thumb-index0", "../../video0")
    assert port_of("/dev/v4l/by-id/usb-thumb-index0", machine) == USB3


def test_what_is_not_on_usb_is_not_counted(machine: Any) -> None:
    machine.put("/dev/video0")
    machine.put("/sys/devices/platform/unicam/video4linux/video0/name", "unicam")
    machine.link("/sys/class/video4linux/video0/device", "../../../devices/platform/unicam")
    assert check_usb([camera(), camera(device=7)], machine) == ()
