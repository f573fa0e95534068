"""Images of ours, played into a video device by tools/rig/feed_video.py, come out of it bit for bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from support.handed_in import PRESSED

from tacshade_edge.devices.camera.v4l2 import V4l2Source

FEEDER = Path(__file__).resolve().parents[2] / "tools/rig/feed_video.py"
PICTURES = 8


def test_captured_luma_is_what_was_sent(tmp_path: Path) -> None:
    """A folder of PNGs at 10 images a second: the capture at 25 fps sees each at least twice, none mixed."""
    rng = np.random.default_rng(7)
    sent = rng.integers(0, 256, (PICTURES, 480, 640), np.uint8)
    sent[0] = np.load(PRESSED / "images.npy", mmap_mode="r")[0]
    for number, image in enumerate(sent):
        assert cv2.imwrite(str(tmp_path / f"{number:03}.png"), image)
    command = [sys.executable, str(FEEDER), "--rate", "10", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as feeder:
        assert feeder.stdout is not None
        assert feeder.stdout.readline() == "playing\n"
        camera = V4l2Source("/dev/video0", 640, 480, 25, "YUYV")
        camera.open()
        frames = [frame for frame in (camera.read() for _ in range(100)) if frame]
        camera.close()
        feeder.terminate()
    assert feeder.returncode == 0
    played = []
    for frame in frames:
        same = [number for number in range(PICTURES) if np.array_equal(frame.image, sent[number])]
        assert len(same) == 1, "not one of the images that were sent"
        played += same
    assert set(played) == set(range(PICTURES))
