"""Faults of the robot's line, the frames, the calibration and the settings; the guest tests a camera's own faults."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import cv2

from tacshade_edge.storage.calibration import calibration_file
from tools.faults.rig import Cell, Seen, fault, pause
from tools.testbed.painted_sensor import BLACK, painted_calibration
from tools.testbed.robot import Faults, PtyRobot

AWAY_S = 2.0


def _robot(cell: Cell, faults: Faults | None = None) -> PtyRobot:
    """Start a robot and the daemon, and wait until their clocks agree."""
    link = Path(f"/dev/shm/tacshade-fault-{os.getpid()}")
    robot: PtyRobot = cell.enter(PtyRobot(link, rate_hz=100, faults=faults))
    cell.start(cell.settings(f"serial: {{device: {link}}}\n"))
    _synchronised(cell)
    return robot


def _synchronised(cell: Cell) -> float:
    return cell.until(lambda: cell.last("status/serial").get("sync") == "two-way", 30, "synchronised")


@fault("serial line pulled, and back")
def unplugged(cell: Cell) -> Seen:
    robot = _robot(cell)
    since_s = cell.mark()
    robot.unplug()
    detected_s = cell.told("serial away", since_s)
    pause(AWAY_S)
    robot.plug()
    recovered_s = _synchronised(cell)
    lost = cell.last("health")["serial"]["poses_lost"]
    told = "log, `status/serial`, EVT to the robot"
    return Seen(f"{lost} poses so far, counted", told, detected_s, recovered_s)


@fault("robot restarts")
def restarts(cell: Cell) -> Seen:
    """Its clock begins anew."""
    robot = _robot(cell, Faults(reboot_s=6.0))
    cell.mark()
    boots = robot.told.boots
    cell.until(lambda: robot.told.boots > boots, 20, "a reboot")
    since_s = time.monotonic()
    detected_s = cell.told("the robot sent a greeting", since_s)
    recovered_s = cell.told("sync two-way", since_s)
    return Seen("poses until the clocks agree again", "log, `status/serial`", detected_s, recovered_s)


@fault("a tenth of the robot's lines damaged")
def noise(cell: Cell) -> Seen:
    _robot(cell, Faults(damage=0.1))
    pause(3.0)
    cell.frames()
    serial = cell.last("health")["serial"]
    assert serial["damaged"] > 0
    assert serial["poses"] > 100
    return Seen(f"{serial['damaged']} lines, counted; none taken for another", "`health.serial`")


@fault("robot falls silent")
def silent(cell: Cell) -> Seen:
    _robot(cell).stop_talking()
    detected_s = cell.until(lambda: cell.last("status/serial").get("state") == "silent", 20, "silent")
    return Seen("frames have no pose", "`status/serial`, `health.serial`", detected_s)


@fault("lens covered, and uncovered")
def black(cell: Cell) -> Seen:
    cell.start()
    pictures = [cell.folder / f"images/{name}.png" for name in ("free", "touched")]
    shown = [path.read_bytes() for path in pictures]

    def show(contents: list[bytes]) -> None:
        for path, content in zip(pictures, contents, strict=True):
            path.with_suffix(".new").write_bytes(content)
            path.with_suffix(".new").replace(path)

    since_s = cell.mark()
    show([cv2.imencode(".png", BLACK)[1].tobytes()] * 2)
    detected_s = cell.told("source unusable", since_s)
    show(shown)
    told = "log, `state` degraded, `status/camera`"
    return Seen("those frames, counted as invalid", told, detected_s, cell.maps_again())


@fault("no calibration at the start")
def no_calibration(cell: Cell) -> Seen:
    path = cell.folder / "c.npz"
    content = path.read_bytes()
    path.unlink()
    cell.serve()
    detected_s = cell.told("not calibrated", cell.start(streams=False))
    path.write_bytes(content)
    return Seen("maps until then", "log, `state` degraded, `info`", detected_s, cell.maps_again())


def _reloaded(cell: Cell, pattern: str) -> float:
    """Reload the settings and wait for a line of the log; return the seconds."""
    since_s = cell.mark()
    cell.daemon.send_signal(signal.SIGHUP)
    return cell.told(pattern, since_s)


@fault("a damaged calibration at a reload")
def bad_calibration(cell: Cell) -> Seen:
    path = cell.folder / "c.npz"
    cell.start()
    crc32 = cell.last("info")["geometry"]["calibration_crc32"]
    path.write_bytes(path.read_bytes()[:-300])
    detected_s = _reloaded(cell, "rejected the reload and kept the running settings")
    cell.maps_again()
    calibration_file.save(path, painted_calibration())
    recovered_s = _reloaded(cell, "reloaded")
    cell.until(lambda: cell.last("info"), 10, "info")
    assert cell.last("info")["geometry"]["calibration_crc32"] == crc32
    return Seen("nothing: the old one goes on", "log, `systemctl status`", detected_s, recovered_s)


@fault("wrong settings at a reload")
def bad_settings(cell: Cell) -> Seen:
    cell.start()
    path = cell.settings("colour: red\n")
    detected_s = _reloaded(cell, rf"{path.name}:\d+: colour: found an unknown key")
    cell.maps_again()
    cell.settings()
    recovered_s = _reloaded(cell, "reloaded")
    return Seen("nothing: the old ones go on", "log, `systemctl status`", detected_s, recovered_s)
