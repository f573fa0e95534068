"""The V4L2 source on the kernel's test driver: real nodes, time stamps and faults."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.patience import stretched, wait_until
from support.vivid import (
    FPS,
    NODE,
    WEBCAM,
    control,
    kept_fps,
    load_driver,
    plug_webcam,
    unload_driver,
)
from tacshade_edge.camera.v4l2 import V4l2Source
from tacshade_edge.errors import ConfigError, DeviceError

TRACING = Path("/sys/kernel/tracing")
DROPS_OF = 100
"""Frames in which drops are counted."""


@pytest.fixture
def webcam() -> None:
    plug_webcam()


def source(**changes: object) -> V4l2Source:
    asked = {
        "device": NODE,
        "width_px": 640,
        "height_px": 480,
        "fps": 30,
        "fourcc": "YUYV",
    } | changes
    return V4l2Source(**asked)  # type: ignore[arg-type]


def read_out(opened: V4l2Source) -> None:
    """Read what is still in the buffers, and on."""
    for _ in range(10):
        opened.read()


@pytest.fixture
def camera(webcam: None) -> Iterator[V4l2Source]:
    opened = source()
    opened.open()
    yield opened
    opened.close()


def test_frames_flow_with_the_kernels_time_stamps(webcam: None) -> None:
    fps = kept_fps()
    camera = source(fps=30 if fps == FPS else fps)
    began_ns = time.monotonic_ns()
    with handed_over() as handed:
        camera.open()
        frames = [camera.read() for _ in range(50)]
        assert all(camera.skip() for _ in range(5))
        after = camera.read()
        described = camera.describe()
        camera.close()
    assert described["time_stamps"] == "kernel"
    assert (described["format"], described["width_px"], described["height_px"]) == (
        "YUYV",
        640,
        480,
    )
    assert described["fps_stated"] == fps, "asked 30, the driver has 25 at this size and says so"
    (first, first_ns), (last, last_ns) = handed[0], handed[-1]
    true_fps = 1e9 * (last - first) / (last_ns - first_ns)
    print(f"{true_fps:.1f} frames a second by the kernel's numbers and stamps")
    assert described["fps_measured"] == pytest.approx(true_fps, rel=0.1)
    assert described["exposure"] == described["white_balance"] == "no control"
    for frame in frames:
        assert frame is not None
        assert frame.image.shape == (480, 640)
        assert frame.image.flags.c_contiguous
        assert frame.image.std() > 20, "the colour bars"
        assert began_ns < frame.t_ns < time.monotonic_ns()
        # A second: whoever reads two clocks here may be interrupted in between.
        assert abs((time.time_ns() - frame.wall_ns) - (time.monotonic_ns() - frame.t_ns)) < 1e9
    times_ns = [frame.t_ns for frame in frames if frame]
    assert all(later > earlier for earlier, later in itertools.pairwise(times_ns))
    assert frames[-1] is not None
    assert after is not None
    assert after.seq >= frames[-1].seq + 6
    assert after.t_ns - frames[-1].t_ns == pytest.approx(
        (after.seq - frames[-1].seq) * 1e9 / true_fps, rel=0.1
    )


@contextmanager
def handed_over() -> Iterator[list[tuple[int, int]]]:
    """Number and time stamp (ns) of each frame, from the kernel's trace:
    OpenCV hides the number.
    """
    handed: list[tuple[int, int]] = []
    switch = TRACING / "events/v4l2/v4l2_dqbuf/enable"
    (TRACING / "trace").write_text("")
    switch.write_text("1")
    yield handed
    switch.write_text("0")
    events = [
        line for line in (TRACING / "trace").read_text().splitlines() if "v4l2_dqbuf:" in line
    ]
    for line in events[1:]:  # OpenCV keeps the very first frame to itself
        fields = dict(re.findall(r"(\w+) = (\d+)", line))
        handed.append((int(fields["sequence"]), int(fields["timestamp"])))


def skip_unless_even(handed: list[tuple[int, int]]) -> None:
    """What is inferred from time stamps holds while they are off by less than 15 % of the period
    (`FrameGaps`).
    """
    (first, first_ns), (last, last_ns) = handed[0], handed[-1]
    period_ns = (last_ns - first_ns) / (last - first)
    off = [
        abs((later[1] - sooner[1]) / period_ns - (later[0] - sooner[0])) > 0.15
        for sooner, later in itertools.pairwise(handed)
    ]
    if 10 * sum(off) > len(off):
        pytest.skip(
            f"the emulated camera is starved: {sum(off)} of {len(off)} of its intervals are off "
            "by over 15 %"
        )


def test_a_frames_time_is_the_kernels(webcam: None) -> None:
    control(
        "timestamp_source=1"
    )  # start of exposure; by default the driver stamps the end, which is yet to come
    camera = source()
    with handed_over() as handed:
        camera.open()
        frames = [frame for frame in (camera.read() for _ in range(25)) if frame]
        camera.close()
    assert camera.describe()["time_stamps"] == "kernel"
    assert [frame.t_ns // 1000 for frame in frames] == [stamp_ns // 1000 for _, stamp_ns in handed]


def test_inferred_drops_are_the_kernels(webcam: None) -> None:
    control("percentage_of_dropped_buffers=10")
    camera = source(fps=kept_fps())
    with handed_over() as handed:
        camera.open()
        frames = [frame for frame in (camera.read() for _ in range(DROPS_OF)) if frame]
        camera.close()
    numbers = [number for number, _ in handed]
    assert len(numbers) == len(frames) == DROPS_OF
    skip_unless_even(handed)
    truth = numbers[-1] - numbers[0] + 1 - len(numbers)
    print(f"{truth} lost by the kernel's numbers, {camera.dropped} inferred")
    assert DROPS_OF / 50 <= truth <= DROPS_OF / 4, "the driver drops at random"
    assert abs(camera.dropped - truth) <= 2
    assert abs((frames[-1].seq - frames[0].seq) - (numbers[-1] - numbers[0])) <= 2


@pytest.mark.parametrize("fourcc", ["GREY", "NV12"])
def test_another_format(webcam: None, fourcc: str) -> None:
    grey, luma = source(fourcc=fourcc), source()
    grey.open()
    frame = grey.read()
    grey.close()
    luma.open()
    other = luma.read()
    luma.close()
    assert frame is not None
    assert other is not None
    assert frame.image.shape == other.image.shape == (480, 640)
    # The same bars: GREY is full range, the luma of the others is the video range and stays so.
    assert (frame.image.min(), other.image.min()) == (0 if fourcc == "GREY" else 16, 16)
    assert (int(frame.image.max()) > int(other.image.max())) is (fourcc == "GREY")


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"fourcc": "MJPG"}, r"640x480 MJPG, but got 640x480 BGR3 \(it offers YUYV, NV12, GREY\)"),
        (
            {"width_px": 648, "height_px": 484},
            r"648x484 YUYV, but got \d+x\d+ YUYV \(it offers .*\)",
        ),
        ({"exposure": 100}, "exposure 100, but the driver has no such control"),
    ],
)
def test_what_it_has_not(webcam: None, changes: dict[str, object], found: str) -> None:
    with pytest.raises(ConfigError, match=rf"^camera /dev/video0: requested {found}$"):
        source(**changes).open()


def test_in_use_by_another(webcam: None) -> None:
    command = ["v4l2-ctl", "-d", NODE, "--stream-mmap"]
    other = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    assert other.stderr is not None
    assert other.stderr.read(1), "it prints a mark for each frame"
    with pytest.raises(DeviceError, match=r"^camera /dev/video0: in use by another program$"):
        source().open()
    assert other.stderr.read(1), "and is not disturbed"
    other.kill()
    other.communicate()


def test_a_stalled_camera_does_not_block(camera: V4l2Source) -> None:
    control("percentage_of_dropped_buffers=100")
    began_s = time.monotonic()
    with pytest.raises(DeviceError, match=r"no frame within \d\.\d s: the camera has stalled$"):
        read_out(camera)
    assert time.monotonic() - began_s < 2 + stretched(1)  # it waits 2 s for a frame
    control("percentage_of_dropped_buffers=0")
    camera.open()
    assert camera.read() is not None


def test_a_fatal_error_ends_reading_until_reopened(camera: V4l2Source) -> None:
    control("inject_fatal_streaming_error=1")
    for _ in range(2):
        with pytest.raises(DeviceError, match="the device is gone, or its driver has stopped"):
            read_out(camera)
    camera.open()
    frames = [camera.read() for _ in range(10)]
    assert all(frames)


def test_unplugged_and_plugged_in_again(camera: V4l2Source) -> None:
    last = camera.read()
    assert last is not None
    keeper = os.open(
        NODE, os.O_RDWR
    )  # the driver takes a disconnect back when its last user has gone
    control("disconnect=1")
    with pytest.raises(DeviceError, match=r"no frame within 0\.\d s: the device is gone"):
        read_out(camera)
    assert Path(NODE).exists()
    with pytest.raises(
        DeviceError, match=r"^camera /dev/video0: cannot open it \(No such device\)$"
    ):
        camera.open()
    os.close(keeper)
    unload_driver()
    with pytest.raises(DeviceError, match="no such device"):
        camera.open()
    plug = threading.Timer(0.5, load_driver, WEBCAM)
    plug.start()
    wait_until(Path(NODE).exists, 10, "the node is back")
    there_s = time.monotonic()
    attempts = itertools.count(1)

    def opens() -> bool:
        next(attempts)
        try:
            camera.open()
        except DeviceError:
            return False
        return True

    wait_until(opens, 10, "the camera opens")
    frame = camera.read()
    took_s = time.monotonic() - there_s
    plug.join()
    assert frame is not None
    print(f"first frame {took_s:.2f} s after the node, at attempt {next(attempts) - 1}")
    assert took_s < stretched(2)
    assert frame.seq > last.seq, "numbers go on across a reopening"


def test_another_camera_in_its_place_is_the_devices_fault(camera: V4l2Source) -> None:
    """The configuration has worked: to end as badly configured would keep the service down."""
    camera.close()
    unload_driver()
    load_driver("node_types=0x1", "num_inputs=1", "input_types=3", "ccs_cap_mode=0")
    with pytest.raises(DeviceError, match="requested 640x480 YUYV, but got 1280x720 YUYV"):
        camera.open()


def test_a_file_in_its_place_is_the_devices_fault(camera: V4l2Source) -> None:
    """What a program that writes to an unplugged camera leaves;
    the same before any frame is the user's mistake.
    """
    camera.close()
    unload_driver()
    device = Path("/dev/video0")
    device.write_bytes(b"")
    try:
        with pytest.raises(DeviceError, match="found a file, expected a video device"):
            camera.open()
        with pytest.raises(ConfigError, match="found a file, expected a video device"):
            source().open()
    finally:
        device.unlink()


def test_a_node_that_does_not_capture() -> None:
    unload_driver()
    load_driver("node_types=0x100", "num_outputs=1", "output_types=1")
    with pytest.raises(
        DeviceError, match="this device node is for output or metadata and captures no video"
    ):
        source().open()
