"""The kernel's test driver for video devices, inside the guest of tools/rig."""

from __future__ import annotations

import subprocess

from support.patience import wait_until

NODE = "/dev/video0"
WEBCAM = ("node_types=0x1", "num_inputs=1", "input_types=0")


def load_driver(*options: str) -> None:
    subprocess.run(["modprobe", "vivid", "n_devs=1", *options], check=True)


def unload_driver() -> None:
    """The driver is busy until the last user of its node has let go."""

    def unloaded() -> bool:
        return subprocess.run(["modprobe", "-r", "vivid"], capture_output=True, check=False).returncode == 0

    wait_until(unloaded, 10, "the driver is unloaded")


def control(text: str) -> None:
    subprocess.run(["v4l2-ctl", "-d", NODE, "-c", text], check=True, capture_output=True)
