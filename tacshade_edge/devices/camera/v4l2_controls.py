"""Lock a camera's automatic controls: what they change would look like touch."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol

import cv2

from tacshade_edge.devices.camera import v4l2_node

_MANUAL_EXPOSURE = 1  # V4L2_EXPOSURE_MANUAL, the value of USB cameras
# What OpenCV cannot set: linux/v4l2-controls.h (FOCUS_AUTO, AUTOGAIN, BACKLIGHT_COMPENSATION, EXPOSURE_AUTO_PRIORITY).
AUTOMATICS = {"focus": 0x009A090C, "gain": 0x00980912, "backlight": 0x0098091C, "frame_rate": 0x009A0903}
"""What else a camera changes by itself, and the control that switches it."""

_NOT_OFFERED = -1.0  # what OpenCV reads for a control that the driver lacks


class Properties(Protocol):
    """The part of ``cv2.VideoCapture`` that sets and reads controls."""

    def get(self, propId: int, /) -> float: ...

    def set(self, propId: int, value: float, /) -> bool: ...


class Lock(StrEnum):
    """Whether a control keeps its value; ``exposure_lock``, ``white_balance_lock`` and others in ``status/camera``."""

    LOCKED = "locked"
    AUTOMATIC = "automatic"
    NO_CONTROL = "no_control"


@dataclass(frozen=True, slots=True)
class Control:
    """A control as read back from the driver. `value`: the driver's value, in its unit; None if it has no such control
    or does not report it.
    """

    lock: Lock
    value: float | None = None

    def __str__(self) -> str:
        if self.lock is Lock.NO_CONTROL:
            return "no control"
        if self.lock is Lock.LOCKED:
            return "locked" if self.value is None else f"locked at {self.value:g}"
        return "automatic; the driver does not lock it" + ("" if self.value is None else f" ({self.value:g})")


def lock_exposure(capture: Properties, exposure: int | None) -> Control:
    """Switch automatic exposure off, then set `exposure` (the driver's unit; None keeps its value)."""
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
    found = {name: v4l2_node.switched_off(device, control_id) for name, control_id in AUTOMATICS.items()}
    locks = {None: Lock.NO_CONTROL, 0: Lock.LOCKED}
    return {name: Control(locks.get(value, Lock.AUTOMATIC)) for name, value in found.items()}


def _set_if_offered(capture: Properties, control: int, value: int) -> float | None:
    """Set a control and read it back; None if the driver lacks it."""
    if capture.get(control) == _NOT_OFFERED:
        return None
    capture.set(control, value)
    return capture.get(control)
