from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from support import rpicam_vid

from tacshade_edge.doctor.camera import check_csi, check_device, check_frames, list_cameras
from tacshade_edge.doctor.cameras import csi_cameras, found_cameras, has_csi_receiver, is_csi, stable_name
from tacshade_edge.doctor.capture import Captured
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import Rpicam, V4l2


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
    assert found_cameras(machine) == ["/dev/v4l/by-id/usb-HD-index0", "/dev/v4l/by-path/usb-0:2", "/dev/video10"]
    assert stable_name("/dev/video10", machine) == ""
    assert list_cameras(machine).found.endswith(
        "/dev/v4l/by-id/usb-HD-index0 (HD Camera), /dev/v4l/by-path/usb-0:2 (Other), /dev/video10 (Third)"
    )


def test_a_raspberry_pis_own_nodes_are_no_cameras(machine: Any) -> None:
    plug(machine, "video0", "rp1-cfe-csi2_ch0")
    plug(machine, "video19", "rpi-hevc-dec")
    plug(machine, "video20", "pispbe-input")
    assert found_cameras(machine) == []
    assert has_csi_receiver(machine)
    assert is_csi("/dev/video20", machine)
    assert "CSI" in list_cameras(machine).fix
    (finding,) = check_device(V4l2(), machine)
    assert (finding.state, finding.found) == (
        "fault",
        "/dev/video0: this node belongs to the Raspberry Pi's own rp1-cfe-csi2_ch0",
    )
    assert finding.fix.endswith("set source: {kind: rpicam, camera: 0}")


def test_a_camera_that_is_not_there(machine: Any) -> None:
    (alone,) = check_device(V4l2(), machine)
    assert (alone.state, alone.found) == ("fault", "/dev/video0: no such device")
    assert alone.fix.startswith("plug a camera in")
    plug(machine, "video2", "HD Camera")
    (other,) = check_device(V4l2(), machine)
    assert other.fix == "set source.device to one of: /dev/video2 (HD Camera)"
    machine.at("/sys/class/video4linux/video2/name").write_text("unicam-image\n")
    (csi,) = check_device(V4l2(), machine)
    assert "CSI" in csi.fix


def test_csi_cameras_are_listed_by_the_boards_program(
    machine: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    (missing,) = check_csi(Rpicam())
    assert (missing.state, missing.fix) == ("fault", "sudo apt install rpicam-apps-lite")
    monkeypatch.undo()
    rpicam_vid.put_on_path(tmp_path, monkeypatch)
    name = "imx219 [3280x2464 10-bit RGGB]"
    assert csi_cameras() == {0: name}
    assert list_cameras(machine).found == f"found {{kind: rpicam, camera: 0}} ({name})"
    (good,) = check_csi(Rpicam())
    assert (good.state, good.found) == ("ok", f"camera 0 of rpicam-vid: {name}")
    (other,) = check_csi(Rpicam(camera=1))
    assert (other.state, other.found) == ("fault", f"rpicam-vid does not list camera 1; it lists 0 ({name})")


def test_a_csi_camera_that_is_held(machine: Any) -> None:
    held = Captured(error=Reason(ReasonCode.IN_USE, "camera 0 of rpicam-vid: failed to acquire camera"))
    (finding,) = check_frames(Rpicam(), held, machine, "streaming")
    assert (finding.state, finding.found) == ("warning", "the daemon is using the camera and reports: streaming")
    assert check_frames(Rpicam(), held, machine, "")[0].state == "fault"


def test_a_file_in_its_place(machine: Any) -> None:
    machine.put("/dev/video0", "not a device")
    (finding,) = check_device(V4l2(), machine)
    assert finding.state == "fault"
    assert "found a file, expected a video device" in finding.found
