"""Cameras and their frames; nodes, formats and busy cameras are looked at in the guest
(tests/guest/test_doctor.py).
"""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support import rpicam_vid
from support.findings import checked, states
from support.painted_sensor import BLACK, FREE
from tacshade_edge.camera.file_source import FilesSource
from tacshade_edge.doctor.camera_check import (
    FRAMES,
    Captured,
    capture,
    check_device,
    check_frames,
    check_other_source,
    check_picture,
    found_cameras,
    list_cameras,
    stable_name,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Rpicam, V4l2

LOCKED = {
    "time_stamps": "kernel",
    **{"exposure": "locked at 157", "exposure_lock": "locked"},
    **{"white_balance": "locked", "white_balance_lock": "locked"},
}
STALLED = Reason(
    ReasonCode.STALLED, "camera /dev/video0: no frame within 2.0 s: the camera has stalled"
)


def frames(fps: float = 30, **changes: Any) -> Captured:
    t_ns = tuple(round(1e9 + k * 1e9 / fps) for k in range(30))
    late = tuple(t + 20_000_000 for t in t_ns)
    values = {"images": (FREE,), "t_ns": t_ns, "arrived_ns": late, "described": LOCKED} | changes
    return Captured(**values)


@pytest.mark.parametrize(
    ("captured", "wrong"),
    [
        (frames(), []),
        (frames(dropped=1), []),  # a stream's start may cost a frame
        (frames(fps=15), ["camera frames"]),
        (frames(dropped=4), ["camera frames"]),
        (frames(described=LOCKED | {"time_stamps": "on arrival"}), ["camera time"]),
        (frames(t_ns=(1_000_000_000,) * 30), ["camera frames", "camera time"]),
        (frames(arrived_ns=(4_000_000_000,) * 30), ["camera time"]),
        (frames(described=LOCKED | {"focus_lock": "locked", "gain_lock": "no_control"}), []),
        (frames(described=LOCKED | {"focus_lock": "automatic"}), ["camera control"]),
        (
            frames(described=LOCKED | {"exposure": "157", "exposure_lock": "automatic"}),
            ["camera control"],
        ),
        (frames(images=(BLACK,)), ["picture"]),
        (Captured(error=STALLED), ["camera frames"]),
    ],
)
def test_what_a_camera_delivered(machine: Any, captured: Captured, wrong: list[str]) -> None:
    findings = checked(check_frames(V4l2(), captured, machine, ""))
    assert [finding.check for finding in findings if finding.state != "ok"] == wrong


@pytest.mark.parametrize(
    ("image", "fix"),
    [
        (np.full((120, 160), 255, np.uint8), "dim"),
        (np.full((120, 160), 90, np.uint8), "focus"),
        (np.zeros((120, 160, 3), np.uint8), "light on"),
    ],
)
def test_a_picture_that_shows_nothing(image: Any, fix: str) -> None:
    finding = check_picture(image)
    assert finding.state == "fault"
    assert fix in finding.fix


@pytest.mark.parametrize(
    ("captured", "found"),
    [
        (frames(), ["ok", "ok"]),
        (frames(fps=5), ["warning", "ok"]),
        (
            frames(images=(FREE,), t_ns=(1,), arrived_ns=(2,), described={"path": "a.png"}),
            ["ok", "ok"],
        ),
        (Captured(error=Reason(ReasonCode.CONFIG, "x: found nothing")), ["fault"]),
        (Captured(), ["fault"]),
    ],
)
def test_other_sources(captured: Captured, found: list[str]) -> None:
    assert states(check_other_source(captured, 30.0)) == found


def plug(machine: Any, node: str, name: str, index: int = 0) -> None:
    machine.put(f"/dev/{node}")
    machine.put(f"/sys/class/video4linux/{node}/name", name + "\n")
    machine.put(f"/sys/class/video4linux/{node}/index", f"{index}\n")


def test_one_name_for_each_camera_and_none_for_metadata(machine: Any) -> None:
    plug(machine, "video0", "HD Camera")
    plug(machine, "video1", "HD Camera", index=1)
    plug(machine, "video2", "Other")
    plug(machine, "video10", "Third")
    machine.link("/dev/v4l/by-path/usb-0:1", "../../video0")
    machine.link("/dev/v4l/by-id/usb-HD-index0", "../../video0")
    machine.link("/dev/v4l/by-path/usb-0:2", "../../video2")
    names = found_cameras(machine)
    assert names == ["/dev/v4l/by-id/usb-HD-index0", "/dev/v4l/by-path/usb-0:2", "/dev/video10"]
    assert stable_name("/dev/video10", machine) == ""
    assert all(name in list_cameras(machine).found for name in names)


def test_a_raspberry_pis_own_nodes_are_no_cameras(machine: Any) -> None:
    plug(machine, "video0", "rp1-cfe-csi2_ch0")
    plug(machine, "video19", "rpi-hevc-dec")
    plug(machine, "video20", "pispbe-input")
    assert found_cameras(machine) == []
    assert "CSI" in list_cameras(machine).fix
    (finding,) = check_device(V4l2(), machine)
    assert finding.state == "fault"
    assert finding.fix.endswith("set source: {kind: rpicam, camera: 0}")


def test_a_camera_that_is_not_there(machine: Any) -> None:
    (alone,) = checked(check_device(V4l2(), machine))
    assert (alone.state, alone.found) == ("fault", "/dev/video0: no such device")
    plug(machine, "video2", "HD Camera")
    assert "/dev/video2" in check_device(V4l2(), machine)[0].fix
    machine.at("/sys/class/video4linux/video2/name").write_text("unicam-image\n")
    assert "CSI" in check_device(V4l2(), machine)[0].fix
    machine.put("/dev/video0", "not a device")
    assert states(check_device(V4l2(), machine)) == ["fault"]


@pytest.mark.slow
def test_csi_cameras(machine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert Rpicam().inspect()[0].fix == "sudo apt install rpicam-apps-lite"
    monkeypatch.undo()
    rpicam_vid.put_on_path(tmp_path, monkeypatch)
    name = "imx219 [3280x2464 10-bit RGGB]"
    assert name in list_cameras(machine).found
    assert states(Rpicam().inspect()) == ["ok"]
    assert states(Rpicam(camera=1).inspect()) == ["fault"]
    held = Captured(
        error=Reason(ReasonCode.IN_USE, "camera 0 of rpicam-vid: failed to acquire camera")
    )
    assert states(check_frames(Rpicam(), held, machine, "streaming")) == ["warning"]
    assert states(check_frames(Rpicam(), held, machine, "")) == ["fault"]


def test_frames_are_taken_as_the_daemon_does(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), FREE)
    captured = capture(FilesSource(path=tmp_path, fps=240, loop=True))
    assert captured.error is None
    assert len(captured.t_ns) == len(captured.arrived_ns) == FRAMES
    assert len(captured.images) == 10, "memory is bounded"
    assert all(later > earlier for earlier, later in itertools.pairwise(captured.t_ns))
    assert 0 < captured.fps < 300
    assert len(capture(FilesSource(path=tmp_path, fps=30, loop=False)).t_ns) == 1, "it ends early"
    (tmp_path / "b.png").write_bytes(b"")
    broken = capture(FilesSource(path=tmp_path, fps=240, loop=False))
    assert len(broken.t_ns) == 1
    assert "b.png" in str(broken.error)
    error = capture(FilesSource(path=tmp_path / "none", fps=30, loop=False)).error
    assert error is not None
    assert error.code is ReasonCode.CONFIG


def test_the_rate_leaves_out_the_first_frames() -> None:
    slow_start = (0, *(2_000_000_000 + k * 20_000_000 for k in range(20)))
    assert Captured(t_ns=slow_start).fps == pytest.approx(50)
    assert Captured(t_ns=(1, 2)).fps == 0
