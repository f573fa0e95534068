"""The kernel's test driver for video devices, inside the guest of tools/rig."""

from __future__ import annotations

import subprocess

from support.patience import slowness, wait_until

NODE = "/dev/video0"
UDEV = ("systemd-udevd-control.socket", "systemd-udevd-kernel.socket", "systemd-udevd.service")
WEBCAM = ("node_types=0x1", "num_inputs=1", "input_types=0")
FPS = 25
"""What the driver gives at 640x480 when asked for more;
it also has the lower ones of `kept_fps`.
"""
KEPT = ((35, FPS), (90, 10), (180, 5))
"""Up to so much slowness an emulated machine keeps up with so many frames a second."""


def kept_fps() -> int:
    """The greatest of the driver's rates that this machine keeps up with; says which."""
    slow = slowness()
    fps = next((fps for limit, fps in KEPT if slow < limit), 2)
    print(
        f"camera at {fps} frames a second, {slow:.0f} times slower than where nothing is emulated"
    )
    return fps


_untouched: tuple[str, ...] = ()
"""The options of the loaded driver, as long as no control of it was changed."""


def load_driver(*options: str) -> None:
    global _untouched
    subprocess.run(["modprobe", "vivid", "n_devs=1", *options], check=True)
    _untouched = options


def plug_webcam() -> None:
    """Where all is emulated it takes seconds to load the driver:
    one on which nothing was changed stays.
    """
    if _untouched != WEBCAM:
        unload_driver()
        load_driver(*WEBCAM)


def unload_driver() -> None:
    """The driver is busy until the last user of its node has let go."""
    global _untouched
    _untouched = ()

    def unloaded() -> bool:
        return (
            subprocess.run(["modprobe", "-r", "vivid"], capture_output=True, check=False).returncode
            == 0
        )

    wait_until(unloaded, 10, "the driver is unloaded")


def control(text: str) -> None:
    global _untouched
    _untouched = ()
    subprocess.run(["v4l2-ctl", "-d", NODE, "-c", text], check=True, capture_output=True)
