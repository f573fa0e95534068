"""A person's first command on a real video device: the camera is found and locked, references are taken."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
from support.handed_in import CAPTURED
from support.person import person
from support.vivid import unload_driver

from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.settings import V4l2, load
from tacshade_edge.storage.tables.capture_folder import CaptureFolder

FEEDER = Path(__file__).resolve().parents[2] / "tools/rig/feed_video.py"
SENSOR = "skin_radius_mm: 20\nvisible_half_angle_deg: 50\ncamera_distance_mm: 14\npolarity: bright\n"


def test_references_are_what_the_camera_showed(tmp_path: Path) -> None:
    out = tmp_path / "sensor"
    out.mkdir()
    (out / "SENSOR.yaml").write_text(SENSOR)
    command = [sys.executable, str(FEEDER), "--rate", "5", str(CAPTURED)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as feeder:
        assert feeder.stdout is not None
        assert feeder.stdout.readline() == "playing\n"
        with person(str(out)) as one:
            one.hears("card vivid")
            one.hears("Enter takes 10 references.")
            one.types("")
            one.hears("10 references, noise")
        feeder.terminate()
    unload_driver()
    folder = CaptureFolder(out)
    references = folder.references()
    assert len(references) == 10
    assert all(np.array_equal(to_grey(image), np.load(CAPTURED)[0]) for image in references)
    source = load(folder.settings).settings.source
    assert isinstance(source, V4l2)
    assert (source.device, source.fourcc) == ("/dev/video0", "YUYV")
