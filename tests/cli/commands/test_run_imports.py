"""What a daemon imports follows its settings: memory and a quick start are for what it does."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import pytest

from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import free_port
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

# Runs the command to the end of its recording, then tells what was imported.
RUN = """
import json, sys
from tacshade_edge import cli
print(json.dumps([cli.main(sys.argv[1:]), *sys.modules]))
"""
OTHERS = {"scipy", "matplotlib", "skimage", "PIL", "serial", "websockets", "iotcore", "sklearn", "torch"}
# Other commands; what waits for a reference to be taken, for a camera, for a simulated source; what needs poses.
COMMANDS, ON_DEMAND, POSES = (
    "simulator studies dashboard doctor daemon.replay",
    "core.calibration.calibrate devices.camera.v4l2 devices.camera.simulated",
    "core.stitching.stitcher core.stitching.press_points daemon.session daemon.session_worker "
    "storage.stitching.stitch_file",
)
OWN = {f"tacshade_edge.{part}" for part in [*COMMANDS.split(), *ON_DEMAND.split()]}
STITCHING = {f"tacshade_edge.{part}" for part in POSES.split()}


def imported(folder: Path, profile: str) -> set[str]:
    settings = folder / f"{profile}.yaml"
    settings.write_text(
        f"profile: {profile}\ncalibration: c.npz\nsource: {{kind: files, path: images, fps: 100}}\n"
        f"mqtt: {{host: 127.0.0.1, port: {free_port()}}}\n"
    )
    command = [sys.executable, "-c", RUN, "run", "--config", str(settings)]
    code, *modules = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert code == 0
    return set(modules)


@pytest.mark.slow
def test_imports_follow_the_settings(tmp_path: Path) -> None:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    (tmp_path / "images").mkdir()
    for i, image in enumerate([FREE, TOUCHED]):
        cv2.imwrite(str(tmp_path / "images" / f"{i}.png"), image)
    network, paper = imported(tmp_path, "fast"), imported(tmp_path, "paper")
    assert "onnxruntime" in network
    assert "onnxruntime" not in paper
    for modules in (network, paper):
        assert "tacshade_edge.storage.recording.image_source" in modules
        assert not modules & (OTHERS | OWN | STITCHING)
    (tmp_path / "images" / "frames.csv").write_text("image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0.png,0,0,0,0,1,0,0,0\n")
    posed = imported(tmp_path, "fast")
    assert posed >= STITCHING
    assert not posed & (OTHERS | OWN)
