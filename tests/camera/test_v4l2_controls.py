"""Locking a camera's automatic controls.

The fake is a driver's control table, as OpenCV shows it.
"""

from __future__ import annotations

import errno
import struct

import cv2
import pytest

from tacshade_edge.camera import v4l2_node
from tacshade_edge.camera.v4l2_node import (
    AUTOMATICS,
    Control,
    Lock,
    lock_exposure,
    lock_others,
    lock_white_balance,
)

AUTO, VALUE, BALANCE = cv2.CAP_PROP_AUTO_EXPOSURE, cv2.CAP_PROP_EXPOSURE, cv2.CAP_PROP_AUTO_WB


class Driver:
    """Controls with a range; the exposure of a USB camera takes no value while it is automatic
    (3).
    """

    def __init__(self, values: dict[int, float], frozen: tuple[int, ...] = ()) -> None:
        self.values = values
        self.frozen = frozen

    def get(self, control: int, /) -> float:
        return self.values.get(control, -1.0)

    def set(self, control: int, value: float, /) -> bool:
        if control not in self.values or control in self.frozen:
            return False
        if control == VALUE:
            if self.values.get(AUTO) == 3:
                return False
            value = min(max(value, 3), 2047)
        self.values[control] = value
        return True


def test_exposure_is_made_manual_before_it_is_set() -> None:
    driver = Driver({AUTO: 3, VALUE: 250})
    control = lock_exposure(driver, 157)
    assert (control, str(control)) == (Control(Lock.LOCKED, 157), "locked at 157")
    assert driver.values == {AUTO: 1, VALUE: 157}


def test_no_wish_keeps_the_value_but_locks_it() -> None:
    driver = Driver({AUTO: 3, VALUE: 250})
    assert lock_exposure(driver, None) == Control(Lock.LOCKED, 250)
    assert driver.values[AUTO] == 1


def test_a_driver_that_stays_automatic_is_reported() -> None:
    control = lock_exposure(Driver({AUTO: 3, VALUE: 250}, frozen=(AUTO,)), 100)
    assert control == Control(Lock.AUTOMATIC, 250)
    assert str(control) == "automatic; the driver does not lock it (250)"


def test_no_such_controls() -> None:
    for control in (lock_exposure(Driver({}), 100), lock_white_balance(Driver({}))):
        assert control == Control(Lock.NO_CONTROL)
        assert str(control) == "no control"


def test_white_balance() -> None:
    driver = Driver({BALANCE: 1})
    assert lock_white_balance(driver) == Control(Lock.LOCKED)
    assert driver.values[BALANCE] == 0
    stays = lock_white_balance(Driver({BALANCE: 1}, frozen=(BALANCE,)))
    assert (stays, str(stays)) == (
        Control(Lock.AUTOMATIC),
        "automatic; the driver does not lock it",
    )


def test_what_else_changes_by_itself_is_switched_off(monkeypatch: pytest.MonkeyPatch) -> None:
    values = {AUTOMATICS["focus"]: 1, AUTOMATICS["frame_rate"]: 1, AUTOMATICS["stabilization"]: 1}
    frozen = AUTOMATICS["frame_rate"]

    def ioctl(_fd: int, request: int, packed: bytearray) -> None:
        control_id, value = struct.unpack("=Ii", packed)
        if control_id not in values:
            raise OSError(errno.EINVAL, "")
        if request == 0xC008561C:
            if control_id == frozen:
                raise OSError(errno.EACCES, "")
            values[control_id] = value
        packed[:] = struct.pack("=Ii", control_id, values[control_id])

    monkeypatch.setattr(v4l2_node, "check_kind", lambda _device: None)
    monkeypatch.setattr(v4l2_node.fcntl, "ioctl", ioctl)
    locks = {name: control.lock for name, control in lock_others("/dev/null").items()}
    found = {"focus": "locked", "frame_rate": "automatic", "stabilization": "locked"}
    assert locks == {**dict.fromkeys(AUTOMATICS, "no_control"), **found}
    assert values[AUTOMATICS["focus"]] == 0
    assert {control.lock for control in lock_others("/dev/none").values()} == {Lock.NO_CONTROL}
