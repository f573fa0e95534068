"""Faults of frames, calibration and settings; the guest tests a camera's own faults (tests/guest)."""

from __future__ import annotations

import signal
import time

import cv2

from tacshade_edge.storage.calibration import calibration_file
from tools.faults.rig import Cell, Seen
from tools.testbed.painted_sensor import BLACK, painted_calibration


def damaged_image(cell: Cell) -> Seen:
    """One frame in 64 cannot be decoded."""
    good = (cell.folder / "images/free.png").read_bytes()
    (cell.folder / "images/bad.png").write_bytes(good[:500])
    table = cell.folder / "images/frames.csv"
    lines = table.read_text().splitlines()
    lines[5] = lines[5].replace("free.png", "bad.png")
    table.write_text("\n".join(lines) + "\n")
    cell.serve()
    cell.start()
    cell.until(lambda: cell.last("health")["frames"]["failed"] > 1, 20, "failed frames")
    frames = cell.frames()
    return Seen(None, None, f"those frames: {frames['failed']} of {frames['captured']}", "`health.frames.failed`")


def black(cell: Cell) -> Seen:
    """The lens is covered and uncovered."""
    cell.serve()
    cell.start()
    pictures = {name: (cell.folder / f"images/{name}.png") for name in ("free", "touched")}
    kept = {name: path.read_bytes() for name, path in pictures.items()}
    since_s = cell.mark()
    for path in pictures.values():
        cv2.imwrite(str(path.with_name("new.png")), BLACK)
        path.with_name("new.png").replace(path)
    detected_s = cell.told("source unusable", since_s)
    since_s = time.monotonic()
    for name, path in pictures.items():
        path.with_name("new.png").write_bytes(kept[name])
        path.with_name("new.png").replace(path)
    recovered_s = cell.maps_again(since_s)
    return Seen(detected_s, recovered_s, "those frames, counted as invalid", "log, `state` degraded, `status/camera`")


def no_calibration(cell: Cell) -> Seen:
    """The calibration is missing at the start and appears later."""
    path = cell.folder / "c.npz"
    data = path.read_bytes()
    path.unlink()
    cell.serve()
    began_s = cell.mark()
    cell.start(streams=False)
    detected_s = cell.told("not calibrated", began_s, 30)
    since_s = time.monotonic()
    path.write_bytes(data)
    recovered_s = cell.maps_again(since_s)
    return Seen(detected_s, recovered_s, "maps until then", "log, `state` degraded, `info`")


def bad_calibration(cell: Cell) -> Seen:
    """A reload finds a damaged calibration, then a good one."""
    path = cell.folder / "c.npz"
    data = path.read_bytes()
    cell.serve()
    cell.start()
    crc32 = cell.last("info")["geometry"]["calibration_crc32"]
    since_s = cell.mark()
    path.write_bytes(data[:-300])
    assert cell.daemon is not None
    cell.daemon.send_signal(signal.SIGHUP)
    detected_s = cell.told("rejected the reload and kept the running settings", since_s)
    cell.maps_again(time.monotonic())
    calibration_file.save(path, painted_calibration())
    since_s = cell.mark()
    cell.daemon.send_signal(signal.SIGHUP)
    recovered_s = cell.told("reloaded", since_s)
    cell.until(lambda: cell.last("info"), 10, "info")
    assert cell.last("info")["geometry"]["calibration_crc32"] == crc32
    return Seen(detected_s, recovered_s, "nothing: the old one goes on", "log, `systemctl status`")


def bad_settings(cell: Cell) -> Seen:
    """A reload finds a wrong key in the settings; the next reload finds it removed."""
    cell.serve()
    cell.start()
    since_s = cell.mark()
    path = cell.settings("colour: red\n")
    assert cell.daemon is not None
    cell.daemon.send_signal(signal.SIGHUP)
    detected_s = cell.told(rf"{path.name}:\d+: colour: found an unknown key", since_s)
    cell.maps_again(time.monotonic())
    since_s = cell.mark()
    cell.settings()
    cell.daemon.send_signal(signal.SIGHUP)
    return Seen(detected_s, cell.told("reloaded", since_s), "nothing: the old ones go on", "log, `systemctl status`")


FAULTS = {
    "one image in 64 damaged": damaged_image,
    "lens covered, and uncovered": black,
    "no calibration at the start": no_calibration,
    "a damaged calibration at a reload": bad_calibration,
    "wrong settings at a reload": bad_settings,
}
