"""What `doctor` says of a real video device: there, absent, busy, of another size, slow,
unplugged.
"""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.vivid import NODE, control, plug_webcam
from tacshade_edge.camera.sources import make_source
from tacshade_edge.camera.v4l2_node import frame_sizes
from tacshade_edge.doctor import Finding
from tacshade_edge.doctor.camera_check import (
    Captured,
    capture,
    check_device,
    check_frames,
    list_cameras,
)
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.settings import V4l2

MACHINE = Machine()
GOOD = V4l2(device=NODE, width_px=640, height_px=480, fps=25, fourcc="YUYV")
BY_ID = Path("/dev/v4l/by-id/usb-test-video-index0")


@pytest.fixture(autouse=True)
def webcam() -> Iterator[None]:
    plug_webcam()
    yield
    BY_ID.unlink(missing_ok=True)


def asked(**changes: object) -> V4l2:
    values = {name: getattr(GOOD, name) for name in GOOD.__struct_fields__} | changes
    return V4l2(**values)  # type: ignore[arg-type]


def states(findings: tuple[Finding, ...]) -> dict[str, str]:
    print(*findings, sep="\n")
    assert all(bool(finding.fix) == (finding.state != "ok") for finding in findings)
    return {finding.check: finding.state for finding in findings}


def frames(source: V4l2) -> tuple[Captured, tuple[Finding, ...]]:
    captured = capture(make_source(source))
    return captured, check_frames(source, captured, MACHINE, "")


def test_a_good_camera() -> None:
    assert states(check_device(GOOD, MACHINE)) == {"camera": "ok", "camera format": "ok"}
    captured, found = frames(GOOD)
    kept_up = captured.dropped <= 1 and captured.fps > 23  # an emulated machine may not
    assert states(found) == {
        "camera frames": "ok" if kept_up else "warning",
        "camera time": "ok",
        "camera control": "ok",
        "picture": "ok",
    }
    assert "no control in this driver" in next(
        f.found for f in found if f.check == "camera control"
    )
    assert list_cameras(MACHINE).found.startswith(f"found {NODE} (vivid")


def test_the_offer_is_the_drivers() -> None:
    listed = subprocess.run(
        ["v4l2-ctl", "-d", NODE, "--list-formats-ext"], check=True, capture_output=True, text=True
    )
    assert "Discrete 640x480" in listed.stdout
    sizes = frame_sizes(NODE, "YUYV")
    assert (640, 480) in sizes
    assert all(f"Discrete {width}x{height}" in listed.stdout for width, height in sizes)
    assert frame_sizes(NODE, "H264") == []
    by_format = check_device(asked(fourcc="MJPG"), MACHINE)[-1]
    assert (by_format.state, by_format.fix) == ("fault", "set source.fourcc: YUYV or NV12 or GREY")


def test_lost_frames() -> None:
    control(
        "percentage_of_dropped_buffers=50"
    )  # by chance: of 20 % it once lost one frame, which is no warning
    captured, found = frames(GOOD)
    assert captured.dropped > 1
    assert found[0].state == "warning"
    assert f"{captured.dropped} lost" in found[0].found


def test_a_stable_name_is_better() -> None:
    BY_ID.parent.mkdir(parents=True, exist_ok=True)
    BY_ID.symlink_to(NODE)
    name = next(
        finding for finding in check_device(GOOD, MACHINE) if finding.check == "camera name"
    )
    assert (name.state, name.fix) == ("warning", f"set source.device: {BY_ID}")
    assert "camera name" not in states(check_device(asked(device=str(BY_ID)), MACHINE))
    (missing,) = check_device(asked(device="/dev/video7"), MACHINE)
    assert missing.state == "fault"
    assert missing.fix.startswith(f"set source.device to one of: {BY_ID} (vivid")


def test_held_by_another_program() -> None:
    command = ["v4l2-ctl", "-d", NODE, "--stream-mmap"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as other:
        assert other.stderr is not None
        assert other.stderr.read(1), "it prints a mark for each frame"
        _, (finding,) = frames(GOOD)
        assert finding.state == "fault"
        assert finding.found.startswith(f"process {other.pid} (v4l2-ctl ")
        assert finding.fix.endswith(f"kill {other.pid}")
        assert other.stderr.read(1), "and is not disturbed"
        other.kill()


def test_unplugged() -> None:
    keeper = os.open(
        NODE, os.O_RDWR
    )  # the driver takes a disconnect back when its last user has gone
    control("disconnect=1")
    (finding,) = check_device(GOOD, MACHINE)
    os.close(keeper)
    assert finding.state == "fault"
    assert finding.found == f"{NODE}: cannot open it (No such device)"


def test_a_camera_that_gives_no_frame() -> None:
    control("percentage_of_dropped_buffers=100")
    _, (finding,) = frames(GOOD)
    assert finding.state == "fault"
    assert finding.found.startswith("no frame within ")
