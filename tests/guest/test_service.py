"""The installed service with a real camera driver, udev, control groups and mosquitto,
under systemd as PID 1.

One boot, one service; the tests follow each other as its days do.
tests/service/test_boot.py has what needs no camera.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import stat
import subprocess
import sys
import sysconfig
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from support.booted_service import CONFIG, UNIT, fresh, journal, process, sh, show, streaming, until
from support.mqtt_rig import Subscriber
from support.patience import patience, stretched, wait_until
from support.vivid import NODE, UDEV, control, unload_driver
from tacshade_edge.camera.sources import make_source
from tacshade_edge.doctor.camera_check import capture, check_frames
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.settings import V4l2
from tacshade_edge.wire import binary

TREE = Path(__file__).resolve().parents[2]
GIVEN = TREE / ".rig/given"
"""By tools/ci/run_guest.py: images.npy (N, 480, 640), calibration.npz,
depth_mm that the core finds.
"""
APP = Path("/opt/tacshade-edge")
STATE = Path("/var/lib/tacshade-edge")
GROUP = Path("/sys/fs/cgroup/system.slice") / UNIT
# The name that 99-tacshade.rules gives to the driver's camera.
CAMERA = Path("/dev/tacshade/camera-platform-vivid_0")
SOURCE = V4l2(device=str(CAMERA), width_px=640, height_px=480, fps=25, fourcc="YUYV")
GOOD = (
    "profile: fast\n"
    f"source: {{kind: v4l2, device: {CAMERA}, width_px: 640, height_px: 480, fps: 25, fourcc: "
    "YUYV}\n"
)
MEMORY_MAX = 150 * 2**20
START_S = 10
STOP_S = 2.0
# What the emulation needs and no machine: time to start, and the tests' own Python in the place of
# Debian's. How long a stop may take is as shipped: the daemon asks for more where it needs it.
DROP_IN = "[Service]\nTimeoutStartSec={start_s:.0f}\nEnvironment=LD_LIBRARY_PATH=/opt/python/lib\n"


@pytest.fixture(scope="module", autouse=True)
def installed() -> None:
    """The shipped files through install.sh; the program from what the tests run with,
    as pip would lay it out.
    """
    assert sh("env", "DESTDIR=/", str(TREE / "systemd/install.sh"))[0] == 0
    python = f"python{sys.version_info[0]}.{sys.version_info[1]}"
    site = APP / "lib" / python / "site-packages"
    binds = {
        site / "tacshade_edge": str(TREE / "tacshade_edge"),
        Path("/opt/python"): sys.base_prefix,
    }
    for path, origin in (
        binds | {Path("/opt/site-packages"): sysconfig.get_path("purelib")}
    ).items():
        path.mkdir(parents=True)
        assert sh("mount", "--bind", origin, str(path))[0] == 0
    (site / "dependencies.pth").write_text("/opt/site-packages\n")
    (APP / "bin").mkdir()
    (APP / "bin/python").symlink_to(f"/opt/python/bin/{python}")
    (APP / "pyvenv.cfg").write_text("home = /opt/python/bin\n")
    script = APP / "bin/tacshade-edge"
    script.write_text(f"#!{APP}/bin/python\nfrom tacshade_edge.cli.entry import entry\nentry()\n")
    script.chmod(0o755)
    drop_in = Path(f"/etc/systemd/system/{UNIT}.d/emulated.conf")
    drop_in.parent.mkdir()
    drop_in.write_text(DROP_IN.format(start_s=patience(START_S)))
    assert sh("systemd-sysusers", "/usr/local/lib/sysusers.d/tacshade-edge.conf")[0] == 0
    assert sh("chgrp", "-R", "tacshade-edge", str(CONFIG.parent))[0] == 0
    STATE.mkdir()
    shutil.copy(GIVEN / "calibration.npz", STATE)
    for path in (STATE, STATE / "calibration.npz"):
        shutil.chown(path, "tacshade-edge", "tacshade-edge")
    for command in (
        ("daemon-reload",),
        ("start", "mosquitto"),
    ):  # with Debian's unit and our drop-in
        assert sh("systemctl", *command)[0] == 0, sh("journalctl", "--no-pager", "-n", "50")[1]
    assert sh("systemctl", "start", *UDEV)[0] == 0


@contextlib.contextmanager
def plugged_in() -> Iterator[None]:
    """A camera that shows the sensor free for 2 s, touched for 4, and so on.

    Udev reports it once it is set up, which takes the only user.
    """
    sh("udevadm", "control", "--stop-exec-queue")
    command = [
        sys.executable,
        str(TREE / "tools/rig/feed_video.py"),
        "--rate",
        "0.5",
        str(GIVEN / "images.npy"),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as feeder:
        assert feeder.stdout is not None
        try:
            assert feeder.stdout.readline() == "playing\n"
            sh("udevadm", "control", "--start-exec-queue")
            yield
        finally:
            feeder.terminate()


def in_status(text: str, seconds: float) -> dict[str, str]:
    """The service's properties once its status says so."""
    now = until(lambda now: text in now["StatusText"], seconds)
    assert text in now["StatusText"], (now, journal())
    return now


def test_it_waits_for_a_camera_that_has_never_been_there() -> None:
    assert not Path(NODE).exists()
    assert fresh(GOOD) == 0, journal()
    now = in_status("away", START_S)
    assert now["ActiveState"] == "active"
    assert now["NRestarts"] == "0"
    assert "videodev" in Path("/proc/modules").read_text(), (
        "the class is known before DeviceAllow names it"
    )


def test_the_life_of_a_plugged_in_camera() -> None:
    before = show()
    with plugged_in():
        assert sh("udevadm", "settle")[0] == 0
        assert CAMERA.resolve() == Path(NODE), "the name by the port"
        node = Path(NODE).stat()
        assert (stat.S_IMODE(node.st_mode), node.st_gid) == (
            0o660,
            int(sh("getent", "group", "video")[1].split(":")[2]),
        )
        streams_unprivileged(before)
        memory_is_counted_and_bounded()
        doctor_leaves_it_the_camera()
        a_stalled_camera_is_left_alone()
    unplugged_it_waits()
    with plugged_in():
        now = until(streaming, START_S)
        assert streaming(now), journal()
        a_clean_stop()


def streams_unprivileged(before: dict[str, str]) -> None:
    """A subscriber decodes the depth that the core finds in the very image,
    and none where the skin is free.
    """
    depth_mm = float((GIVEN / "depth_mm").read_text())
    with Subscriber(1883, "tacshade/tacshade/height") as seen:

        def found() -> bool:
            new = [seen.messages.pop(0).payload for _ in range(len(seen.messages))]
            maps = [binary.decode(data).height_mm for data in new]  # type: ignore[union-attr]
            depths_mm.extend(float(np.nanmax(each)) for each in maps)
            return 0 in depths_mm and any(abs(each - depth_mm) < 0.001 for each in depths_mm)

        depths_mm: list[float] = []
        wait_until(found, START_S, f"0 and {depth_mm} mm, got {depths_mm}")
    now = in_status("streaming, ", 20)
    assert now["MainPID"] == before["MainPID"], journal()  # plugging in takes no restart
    who = process(now["MainPID"])
    assert "0" not in who["Uid"].split()
    assert (int(who["CapEff"], 16), who["NoNewPrivs"], who["Seccomp"]) == (0, "1", "2")
    assert sh("getent", "group", "video")[1].split(":")[2] in who["Groups"].split()


def memory_is_counted_and_bounded() -> None:
    assert int((GROUP / "memory.max").read_text()) == MEMORY_MAX
    assert (GROUP / "memory.swap.max").read_text().strip() == "0"
    now = show()
    counted, resident = int(now["MemoryCurrent"]), process(now["MainPID"])["VmRSS"]
    print(f"MemoryCurrent {counted / 2**20:.0f} MB, VmRSS {resident}")
    assert 20 * 2**20 < counted < MEMORY_MAX


def doctor_leaves_it_the_camera() -> None:
    machine, pid = Machine(), int(show()["MainPID"])
    found = machine.daemon()
    assert found is not None
    assert [held.pid for held in machine.holders(str(CAMERA))] == [found.pid] == [pid]
    (finding,) = check_frames(
        SOURCE, capture(make_source(SOURCE)), machine, "online, 25.0 frames/s"
    )
    assert finding.state == "warning"
    assert finding.found == "the daemon is using the camera and reports: online, 25.0 frames/s"


def a_stalled_camera_is_left_alone() -> None:
    before = show()
    control("percentage_of_dropped_buffers=100")
    in_status("the camera has stalled", 20)
    control("percentage_of_dropped_buffers=0")
    now = in_status("streaming, ", 20)
    assert (now["MainPID"], now["NRestarts"]) == (before["MainPID"], before["NRestarts"])


def unplugged_it_waits() -> None:
    before = show()
    keeper = os.open(
        NODE, os.O_RDWR
    )  # the driver takes a disconnect back when its last user has gone
    control("disconnect=1")
    in_status("away", 20)
    Path(NODE).unlink()  # a real unplug does this, and the daemon must not take hold of it again
    os.close(keeper)
    unload_driver()
    wait_until(lambda: not CAMERA.is_symlink(), 10, "udev takes the name away")
    now = in_status("away", 1)
    assert (now["ActiveState"], now["MainPID"], now["NRestarts"]) == (
        "active",
        before["MainPID"],
        before["NRestarts"],
    )


def a_clean_stop() -> None:
    """It says goodbye, and its end is what it said."""
    with Subscriber(1883) as seen:
        seen.wait_for("tacshade/tacshade/height", 1, 20)
        limit_s = stretched(STOP_S)
        began_s = time.monotonic()
        assert sh("systemctl", "stop", UNIT)[0] == 0
        took_s = time.monotonic() - began_s
        seen.wait_for_last("tacshade/tacshade/state", b"stopped")
    now = show()
    assert (now["ActiveState"], now["Result"], now["ExecMainStatus"]) == (
        "inactive",
        "success",
        "0",
    ), journal()
    print(f"stopped within {took_s:.1f} s, emulated, of {limit_s:.1f} s allowed")
    assert took_s < limit_s
