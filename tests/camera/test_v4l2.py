"""What needs no camera: bad paths, bad arguments, decoding.

The rest is in tests/guest, under a real driver.
"""

from __future__ import annotations

import errno
import fcntl
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.camera.v4l2 import FOURCCS, V4l2Source, decode
from tacshade_edge.errors import ConfigError, DeviceError, TacshadeError

H, W = 48, 64
RNG = np.random.default_rng(5)
PICTURE = cv2.GaussianBlur(RNG.integers(0, 256, (H, W), np.uint8), (0, 0), 3)
JPEG = cv2.imencode(".jpg", PICTURE)[1]


def source(device: str) -> V4l2Source:
    return V4l2Source(device=device, width_px=W, height_px=H, fps=30, fourcc="YUYV")


def why_not(device: str, kind: type[TacshadeError] = DeviceError) -> str:
    """The one line that opening gives."""
    with pytest.raises(kind) as caught:
        source(device).open()
    text = str(caught.value)
    assert "\n" not in text
    return text


EXPECTED = "expected a video device such as /dev/video0 or one under /dev/v4l/by-id"


def test_missing_device() -> None:
    assert why_not("/dev/video63") == f"camera /dev/video63: no such device, {EXPECTED}"


def test_regular_file(tmp_path: Path) -> None:
    file = tmp_path / "video0"
    file.write_bytes(b"not a camera")
    assert why_not(str(file), ConfigError) == f"camera {file}: found a file, {EXPECTED}"
    assert why_not(f"{file}/below") == f"camera {file}/below: no such device, {EXPECTED}"


def test_a_fifo_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    assert "found a file" in why_not(str(tmp_path / "fifo"), ConfigError)


def asks_kernel() -> bool:
    """Whether VIDIOC_QUERYCAP gets to the kernel."""
    try:
        with Path("/dev/null").open("rb") as null:
            fcntl.ioctl(null, 0x80685600, bytearray(104))
    except OSError as error:
        return error.errno != errno.ENOSYS
    return True


@pytest.mark.skipif(
    not asks_kernel(), reason="QEMU's emulation of a user space passes no video request on"
)
def test_another_device() -> None:
    assert (
        why_not("/dev/null", ConfigError)
        == f"camera /dev/null: found another kind of device, {EXPECTED}"
    )


def test_a_dangling_link(tmp_path: Path) -> None:
    """What is left in /dev/v4l/by-id for a moment after an unplug."""
    (tmp_path / "by-id").symlink_to(tmp_path / "gone")
    assert "no such device" in why_not(str(tmp_path / "by-id"))


def test_reading_without_opening_and_closing_twice() -> None:
    camera = source("/dev/video63")
    for take in (camera.read, camera.skip):
        with pytest.raises(DeviceError, match="not open"):
            take()
    camera.close()
    camera.close()
    assert camera.dropped == 0
    assert camera.describe() == {"device": "/dev/video63", "fps_measured": 0.0}


@pytest.mark.parametrize(
    "changes",
    [
        {"fourcc": "H264"},
        {"fourcc": "yuyv"},
        {"width_px": 0},
        {"height_px": -1},
        {"fps": 0},
        {"fps": float("nan")},
    ],
)
def test_arguments_that_suit_no_camera(changes: dict[str, object]) -> None:
    asked = {
        "device": "/dev/video0",
        "width_px": W,
        "height_px": H,
        "fps": 30.0,
        "fourcc": "YUYV",
    } | changes
    with pytest.raises(ConfigError, match=r"^camera /dev/video0: .*expected"):
        V4l2Source(**asked)  # type: ignore[arg-type]


def test_luma_is_passed_on_untouched() -> None:
    yuyv = RNG.integers(0, 256, (H, W, 2), np.uint8)
    grey = decode(yuyv.reshape(-1), "YUYV", H, W)
    assert grey is not None
    assert grey.flags.c_contiguous
    np.testing.assert_array_equal(grey, yuyv[:, :, 0])
    np.testing.assert_array_equal(decode(PICTURE.reshape(-1), "GREY", H, W), PICTURE)
    nv12 = np.concatenate([PICTURE.reshape(-1), RNG.integers(0, 256, H * W // 2, np.uint8)])
    grey = decode(nv12, "NV12", H, W)
    assert grey is not None
    assert np.shares_memory(grey, nv12)
    np.testing.assert_array_equal(grey, PICTURE)


@pytest.mark.parametrize(("fourcc", "bytes_per_px"), [("YUYV", 2), ("NV12", 1.5), ("GREY", 1)])
@pytest.mark.parametrize("change", [-1, 1, W])
def test_a_buffer_of_another_size_is_no_image(
    fourcc: str, bytes_per_px: float, change: int
) -> None:
    """Short after lost USB packets; longer when the driver pads its lines,
    which would shear the image.
    """
    size = int(H * W * bytes_per_px)
    assert decode(np.zeros(size, np.uint8), fourcc, H, W) is not None
    assert decode(np.zeros(size + change, np.uint8), fourcc, H, W) is None


def test_jpeg_is_decoded_to_its_luma() -> None:
    grey = decode(JPEG, "MJPG", H, W)
    assert grey is not None
    assert np.abs(grey.astype(int) - PICTURE).mean() < 3
    padded = np.concatenate([JPEG, np.zeros(1000, np.uint8)])  # as many USB cameras pad
    np.testing.assert_array_equal(decode(padded, "MJPG", H, W), grey)


@given(st.integers(0, JPEG.size - 1))
def test_a_truncated_jpeg_is_no_frame(size: int) -> None:
    assert decode(JPEG[:size], "MJPG", H, W) is None


@given(
    st.lists(st.tuples(st.integers(0, JPEG.size - 1), st.integers(0, 255)), min_size=1, max_size=40)
)
def test_a_damaged_jpeg_never_raises(damage: list[tuple[int, int]]) -> None:
    bad = JPEG.copy()
    for place, value in damage:
        bad[place] = value
    image = decode(bad, "MJPG", H, W)
    assert image is None or (image.shape == (H, W) and image.dtype == np.uint8)


@given(st.binary(max_size=300))
def test_any_bytes_never_raise(data: bytes) -> None:
    for fourcc in FOURCCS:
        image = decode(np.frombuffer(b"\xff\xd8" + data + b"\xff\xd9", np.uint8), fourcc, 2, 3)
        assert image is None or image.shape == (2, 3)
