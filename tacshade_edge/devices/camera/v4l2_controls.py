"""A camera's automatic controls, switched off: what they change would look like touch."""

from __future__ import annotations

from typing import Protocol

import cv2

_MANUAL_EXPOSURE = 1  # V4L2_EXPOSURE_MANUAL, the value of USB cameras
_NOT_OFFERED = -1.0  # what OpenCV reads of a control that a driver has not
_NOT_LOCKED = "automatic, the driver does not lock it"


class Properties(Protocol):
    """The part of ``cv2.VideoCapture`` that sets and reads controls."""

    def get(self, propId: int, /) -> float: ...

    def set(self, propId: int, value: float, /) -> bool: ...


def lock_exposure(capture: Properties, exposure: int | None) -> tuple[float | None, str]:
    """Switch automatic exposure off, then set `exposure` (the driver's unit; None keeps its value).

    Returns
    -------
    value : float or None
        What the driver holds now; None when it has no such control.
    text : str
        The same for a person.
    """
    automatic = _set_if_offered(capture, cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
    if exposure is not None:
        capture.set(cv2.CAP_PROP_EXPOSURE, exposure)
    value = capture.get(cv2.CAP_PROP_EXPOSURE)
    if value == _NOT_OFFERED:
        return None, "no control"
    locked = automatic in (None, _MANUAL_EXPOSURE)
    return value, f"locked at {value:g}" if locked else f"{_NOT_LOCKED} ({value:g})"


def lock_white_balance(capture: Properties) -> str:
    """Switch automatic white balance off; return what holds, for a person."""
    automatic = _set_if_offered(capture, cv2.CAP_PROP_AUTO_WB, 0)
    if automatic is None:
        return "no control"
    return "locked" if automatic == 0 else _NOT_LOCKED


def _set_if_offered(capture: Properties, control: int, value: int) -> float | None:
    """Set a control and read it back; None when the driver has it not."""
    if capture.get(control) == _NOT_OFFERED:
        return None
    capture.set(control, value)
    return capture.get(control)
