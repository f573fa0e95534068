"""Faults of the robot and its line, on a pty."""

from __future__ import annotations

import os
import time
from pathlib import Path

from tools.faults.rig import SENSOR_ID, Cell, Seen, pause
from tools.testbed.robot import Faults, PtyRobot

AWAY_S = 2.0


def _with_robot(cell: Cell, faults: Faults | None = None) -> PtyRobot:
    link = Path(f"/dev/shm/tacshade-fault-{os.getpid()}")
    robot: PtyRobot = cell.enter(PtyRobot(link, rate_hz=100, faults=faults))
    cell.serve()
    cell.start(cell.settings(f"serial: {{device: {link}}}\n"))
    cell.until(lambda: cell.last("status/serial").get("sync") == "two-way", 30, "synchronised")
    return robot


def unplugged(cell: Cell) -> Seen:
    """The cable is pulled and plugged in again."""
    robot = _with_robot(cell)
    since_s = cell.mark()
    robot.unplug()
    detected_s = cell.told("serial away", since_s)
    pause(AWAY_S)
    since_s = time.monotonic()
    robot.plug()
    cell.until(lambda: cell.last("status/serial").get("sync") == "two-way", 20, "synchronised again")
    recovered_s = time.monotonic() - since_s
    lost = cell.last("health")["serial"]["poses_lost"]
    return Seen(detected_s, recovered_s, f"{lost} poses so far, counted", "log, `status/serial`, EVT to the robot")


def reboots(cell: Cell) -> Seen:
    """The robot restarts with another clock."""
    robot = _with_robot(cell, Faults(reboot_s=6.0))
    cell.mark()
    boots = robot.told.boots
    cell.until(lambda: robot.told.boots > boots, 20, "a reboot")
    since_s = time.monotonic()
    detected_s = cell.told("the robot sent a greeting", since_s)
    recovered_s = cell.told("sync two-way", since_s)
    return Seen(detected_s, recovered_s, "poses until the clocks agree again", "log, `status/serial`")


def noise(cell: Cell) -> Seen:
    """A tenth of the lines are damaged."""
    _with_robot(cell, Faults(damage=0.1))
    pause(3.0)
    cell.frames()
    serial = cell.last("health")["serial"]
    assert serial["damaged"] > 0
    assert serial["poses"] > 100
    return Seen(None, None, f"{serial['damaged']} lines, counted; none taken for another", "`health.serial`")


def silent(cell: Cell) -> Seen:
    """The robot falls silent."""
    robot = _with_robot(cell)
    since_s = cell.mark()
    robot.stop_talking()
    cell.until(lambda: cell.last("status/serial").get("state") == "silent", 20, "silent")
    return Seen(time.monotonic() - since_s, None, "frames have no pose", "`status/serial`, `health.serial`")


def shared_line(cell: Cell) -> Seen:
    """A second daemon opens the same port."""
    _with_robot(cell)
    text = (cell.folder / "s.yaml").read_text()
    path = cell.folder / "other.yaml"
    path.write_text(text.replace(f"sensor_id: {SENSOR_ID}", "sensor_id: other").replace("maps}", "maps2}"))
    poses = cell.last("health")["serial"]["poses"]
    since_s = time.monotonic()
    other = cell.spawn(path, "other")
    try:
        cell.until(lambda: "serial away" in cell.log("other"), 20, f"told: {cell.log('other')[-300:]!r}")
        detected_s = time.monotonic() - since_s
        cell.until(lambda: cell.last("health")["serial"]["poses"] > poses + 100, 20, "the first goes on")
        assert cell.last("health")["serial"]["poses_lost"] == 0
    finally:
        other.kill()
        other.wait()
    return Seen(detected_s, None, "nothing: the first keeps it", "log, `status/serial` of the second")


FAULTS = {
    "serial line pulled, and back": unplugged,
    "robot restarts": reboots,
    "a tenth of the robot's lines damaged": noise,
    "robot falls silent": silent,
    "a second daemon, same serial port": shared_line,
}
