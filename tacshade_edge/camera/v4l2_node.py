"""Queries to the kernel about a video device node: OpenCV reports a failure but not its cause."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Protocol

import cv2

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.quoting import escaped
from tacshade_edge.reasons import ReasonCode

# linux/videodev2.h
# The numbers contain the sizes of their structures, which have no pointers: every processor has the
# same.
_VIDIOC_G_CTRL, _VIDIOC_S_CTRL = 0xC008561B, 0xC008561C
_VIDIOC_QUERYCAP = 0x80685600
_VIDIOC_ENUM_FMT = 0xC0405602
_VIDIOC_ENUM_FRAMESIZES = 0xC02C564A
_VIDIOC_REQBUFS = 0xC0145608
_DISCRETE = 1  # V4L2_FRMSIZE_TYPE_DISCRETE
_MOST_ENTRIES = 256  # of a driver's list: one that never ends it is broken
_BUF_TYPES = (1, 9)  # capture, and the multi-planar one
_CAPTURE = 0x00000001 | 0x00001000  # V4L2_CAP_VIDEO_CAPTURE, _MPLANE
_MEMORY_MMAP = 1
_EXPECTED = "expected a video device such as /dev/video0 or one under /dev/v4l/by-id"


def check_kind(device: str) -> None:
    """Reject an existing path that can never be a camera; an absent device may still appear.

    Raises ConfigError (a file, a directory, or a device of another class).
    """
    try:
        status = os.stat(device)
    except (OSError, ValueError):
        return
    if not stat.S_ISCHR(status.st_mode):
        kind = "directory" if stat.S_ISDIR(status.st_mode) else "file"
        raise ConfigError(
            f"camera {device}: found a {kind}, {_EXPECTED}", code=ReasonCode.WRONG_KIND
        )
    number = f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
    subsystem = Path("/sys/dev/char", number, "subsystem")
    # A node without an entry there is being plugged or unplugged: opening it shows which.
    if subsystem.exists() and subsystem.resolve().name != "video4linux":
        raise ConfigError(
            f"camera {device}: found another kind of device, {_EXPECTED}",
            code=ReasonCode.WRONG_KIND,
        )


def check_node(device: str) -> str:
    """Return the name of the camera behind a device node.

    Raises ConfigError (as `check_kind`), DeviceError (the node is absent, does not capture video,
    or may not be opened; the message says which, in one line).
    """
    with _opened(device) as fd:
        # struct v4l2_capability: driver 16 bytes, card 32, bus 32, version, capabilities,
        # device_caps.
        capability = bytearray(104)
        try:
            fcntl.ioctl(fd, _VIDIOC_QUERYCAP, capability)
        except OSError as error:
            text = f"camera {device}: its driver does not answer ({error.strerror})"
            raise DeviceError(text, code=ReasonCode.NO_ANSWER) from None
    # device_caps, of this node, not capabilities, of all nodes of the camera: a USB camera has one
    # for metadata beside the one that captures.
    if not int.from_bytes(capability[88:92], "little") & _CAPTURE:
        found = "this device node is for output or metadata and captures no video"
        text = f"camera {device}: {found}; v4l2-ctl --list-devices shows the other nodes"
        raise DeviceError(text, code=ReasonCode.WRONG_KIND)
    return capability[16:48].split(b"\0")[0].decode(errors="replace")


def formats(device: str) -> list[str]:
    """Return the four-character codes of the pixel formats that the device offers.

    Raises as `check_node` does.
    """
    codes = []
    with _opened(device) as fd:
        for kind in _BUF_TYPES:
            with suppress(OSError):  # the end of the list, EINVAL
                for index in range(_MOST_ENTRIES):
                    entry = bytearray(struct.pack("<2I56x", index, kind))
                    fcntl.ioctl(fd, _VIDIOC_ENUM_FMT, entry)
                    codes.append(entry[44:48].decode("ascii", errors="replace").strip())
    return codes


def frame_sizes(device: str, fourcc: str) -> list[tuple[int, int]]:
    """Return each width and height that the device offers in a pixel format, px.

    Empty if the driver lists none or offers any size of a range. Raises as `check_node` does.
    """
    found = []
    (code,) = struct.unpack("<I", fourcc.ljust(4).encode("ascii"))
    with _opened(device) as fd, suppress(OSError):  # the end of the list, EINVAL
        for index in range(_MOST_ENTRIES):
            # struct v4l2_frmsizeenum: index, format, type, then a union.
            entry = bytearray(struct.pack("<2I36x", index, code))
            fcntl.ioctl(fd, _VIDIOC_ENUM_FRAMESIZES, entry)
            kind, width_px, height_px = struct.unpack_from("<3I", entry, 8)
            # Of a range, the driver lists one entry with least, most and step.
            if kind != _DISCRETE:
                return []
            found.append((width_px, height_px))
    return found


def is_busy(device: str) -> bool:
    """Whether another program holds the device's buffers.

    Call only after opening failed: it disturbs a stream.
    """
    with _opened(device) as fd:
        for buf_type in _BUF_TYPES:
            try:
                fcntl.ioctl(
                    fd,
                    _VIDIOC_REQBUFS,
                    # Asking for no buffers is refused while another program holds some.
                    bytearray(struct.pack("<5I", 0, buf_type, _MEMORY_MMAP, 0, 0)),
                )
            except OSError as error:
                if error.errno == errno.EBUSY:
                    return True
    return False


@contextmanager
def _opened(device: str) -> Iterator[int]:
    """Open a node of the video4linux class. Raises as `check_node` does."""
    check_kind(device)
    try:
        # O_NONBLOCK: opening a node must not wait for a driver that hangs.
        fd = os.open(device, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        raise DeviceError(
            f"camera {escaped(device)}: no such device, {_EXPECTED}", code=ReasonCode.ABSENT
        ) from None
    except PermissionError:
        text = f"camera {device}: no permission to open it (is the user in the group video?)"
        raise DeviceError(text, code=ReasonCode.PERMISSION) from None
    except OSError as error:
        raise DeviceError(f"camera {device}: cannot open it ({error.strerror})") from None
    try:
        yield fd
    finally:
        os.close(fd)


_MANUAL_EXPOSURE = 1  # V4L2_EXPOSURE_MANUAL, the value of USB cameras
# What OpenCV cannot set: linux/v4l2-controls.h (FOCUS_AUTO, AUTOGAIN, BACKLIGHT_COMPENSATION,
# EXPOSURE_AUTO_PRIORITY, AUTOBRIGHTNESS, WIDE_DYNAMIC_RANGE, IMAGE_STABILIZATION).
AUTOMATICS = {
    "focus": 0x009A090C,
    "gain": 0x00980912,
    "backlight": 0x0098091C,
    "frame_rate": 0x009A0903,
    "brightness": 0x00980920,
    "dynamic_range": 0x009A0915,
    "stabilization": 0x009A0916,
}
"""What else a camera changes by itself, and the control that switches it."""

_NOT_OFFERED = -1.0  # what OpenCV reads for a control that the driver lacks


class Properties(Protocol):
    """The part of ``cv2.VideoCapture`` that sets and reads controls."""

    def get(self, propId: int, /) -> float: ...

    def set(self, propId: int, value: float, /) -> bool: ...


class Lock(StrEnum):
    """Whether a control keeps its value; ``exposure_lock``,
    ``white_balance_lock`` and others in ``status/camera``.
    """

    LOCKED = "locked"
    AUTOMATIC = "automatic"
    NO_CONTROL = "no_control"


@dataclass(frozen=True, slots=True)
class Control:
    """A control as read back from the driver.

    `value`: the driver's value, in its unit; None if it has no such control or does not report it.
    """

    lock: Lock
    value: float | None = None

    def __str__(self) -> str:
        if self.lock is Lock.NO_CONTROL:
            return "no control"
        if self.lock is Lock.LOCKED:
            return "locked" if self.value is None else f"locked at {self.value:g}"
        return "automatic; the driver does not lock it" + (
            "" if self.value is None else f" ({self.value:g})"
        )


def lock_exposure(capture: Properties, exposure: int | None) -> Control:
    """Switch automatic exposure off, then set `exposure` (the driver's unit;
    None keeps its value).
    """
    # In this order: while the exposure is automatic, drivers refuse a value.
    automatic = _set_if_offered(capture, cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
    if exposure is not None:
        capture.set(cv2.CAP_PROP_EXPOSURE, exposure)
    value = capture.get(cv2.CAP_PROP_EXPOSURE)
    if value == _NOT_OFFERED:
        return Control(Lock.NO_CONTROL)
    return Control(Lock.LOCKED if automatic in (None, _MANUAL_EXPOSURE) else Lock.AUTOMATIC, value)


def lock_white_balance(capture: Properties) -> Control:
    """Switch automatic white balance off."""
    automatic = _set_if_offered(capture, cv2.CAP_PROP_AUTO_WB, 0)
    if automatic is None:
        return Control(Lock.NO_CONTROL)
    return Control(Lock.LOCKED if automatic == 0 else Lock.AUTOMATIC)


def lock_others(device: str) -> dict[str, Control]:
    """Switch off everything else that a camera changes by itself, by the names of `AUTOMATICS`."""
    found: dict[str, Control] = {}
    try:
        with _opened(device) as fd:
            for name, control_id in AUTOMATICS.items():
                off = struct.pack("=Ii", control_id, 0)
                packed = bytearray(off)
                try:
                    fcntl.ioctl(fd, _VIDIOC_G_CTRL, packed)
                    # Read-only, or the driver refuses: the value read back says so.
                    with suppress(OSError):
                        fcntl.ioctl(fd, _VIDIOC_S_CTRL, bytearray(off))
                    fcntl.ioctl(fd, _VIDIOC_G_CTRL, packed)
                except OSError:
                    continue  # no such control
                found[name] = Control(
                    Lock.AUTOMATIC if struct.unpack("=Ii", packed)[1] else Lock.LOCKED
                )
    except (ConfigError, DeviceError):
        pass
    # A node that is gone by now is reported by the next frame, in better words.
    return {name: found.get(name, Control(Lock.NO_CONTROL)) for name in AUTOMATICS}


def _set_if_offered(capture: Properties, control: int, value: int) -> float | None:
    """Set a control and read it back; None if the driver lacks it."""
    if capture.get(control) == _NOT_OFFERED:
        return None
    capture.set(control, value)
    return capture.get(control)
