#!/usr/bin/env python3
"""Play grey images as a camera, inside the guest: bit-exact frames on a real capture node.

::

    python3 -m tools.rig.feed_video [--rate FPS] FRAMES

FRAMES is a ``.npy`` stack, uint8 (N, 480, 640), played round and round. The kernel's test driver
(vivid) is loaded with an HDMI output that is looped to its HDMI input: /dev/video0 captures 640x480
YUYV at 25 fps whose Y plane is the image that was last played. Prints ``playing`` when the first
image can be captured; ends on SIGTERM.
"""

from __future__ import annotations

import argparse
import itertools
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

CAPTURE, OUTPUT = "/dev/video0", "/dev/video1"
SHAPE = (480, 640)
FPS = 25
# The one standard timing at 25 Hz; both ends use its upper left corner, unscaled (ccs:
# crop, compose, scale).
SIGNAL = ("Active width: 1280", "Active height: 720", "(25.00 frames per second)")
LOOP = (
    "node_types=0x101 num_inputs=1 input_types=3 num_outputs=1 output_types=1 ccs_cap_mode=1 "
    "ccs_out_mode=2"
)


def load(path: Path) -> list[bytes]:
    """YUYV bytes of every image; the chroma is neutral."""
    images = np.load(path)
    if images.shape[1:] != SHAPE or images.dtype != np.uint8:
        sys.exit(f"feed_video: {path}: expected grey images of {SHAPE[1]}x{SHAPE[0]}, 8 bit")
    frames = np.full((*images.shape, 2), 128, np.uint8)
    frames[..., 0] = images
    return [frame.tobytes() for frame in frames]


def set_up() -> None:
    """Load the driver and loop its output to its input."""
    subprocess.run(["modprobe", "vivid", "n_devs=1", *LOOP.split()], check=True)
    listed = _ctl(OUTPUT, "--list-dv-timings").split("Index: ")[1:]
    index = next(text.split()[0] for text in listed if all(word in text for word in SIGNAL))
    for device in (OUTPUT, CAPTURE):
        _ctl(device, "--set-dv-bt-timings", f"index={index}")
    _ctl(OUTPUT, f"--set-fmt-video-out=width={SHAPE[1]},height={SHAPE[0]},pixelformat=YUYV")
    _ctl(CAPTURE, "--set-ctrl", "loop_video=1,osd_text_mode=2")


def play(frames: list[bytes], rate: float) -> None:
    """Feed the frames to the output endlessly; the driver shows each until the next comes."""
    command = ["v4l2-ctl", "-d", OUTPUT, "--stream-out-mmap=2", "--stream-from=-"]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=quiet, stderr=quiet) as player:
        assert player.stdin is not None
        signal.signal(signal.SIGTERM, lambda *_: player.kill())
        try:
            player.stdin.write(2 * frames[0])  # both buffers are filled before it starts
            print("playing", flush=True)
            due_s = time.monotonic()
            for played in itertools.count():
                player.stdin.write(frames[played % len(frames)])
                player.stdin.flush()
                due_s = max(due_s + 1 / rate, time.monotonic())
                time.sleep(max(0.0, due_s - time.monotonic()))
        except BrokenPipeError:
            player.wait()
    if player.returncode != -signal.SIGKILL:  # not by our SIGTERM
        sys.exit(f"feed_video: v4l2-ctl ended with {player.returncode}")


def _ctl(device: str, *arguments: str) -> str:
    done = subprocess.run(["v4l2-ctl", "-d", device, *arguments], capture_output=True, text=True)
    if done.returncode:
        sys.exit(
            f"feed_video: v4l2-ctl -d {device} {' '.join(arguments)}: "
            f"{done.stdout.strip()}{done.stderr.strip()}"
        )
    return done.stdout


def main() -> None:
    """Parse the command line and play."""
    parser = argparse.ArgumentParser(
        prog="feed_video.py", description="Play grey images as /dev/video0."
    )
    parser.add_argument("frames", type=Path, metavar="FRAMES", help=".npy stack, 640x480")
    parser.add_argument(
        "--rate", type=float, default=FPS, metavar="FPS", help=f"images a second ({FPS})"
    )
    args = parser.parse_args()
    frames = load(args.frames)
    set_up()
    play(frames, args.rate)


if __name__ == "__main__":
    main()
