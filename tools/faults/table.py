"""Each fault once, in real parts, and the table of their outcomes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2

from support.painted_sensor import BLACK, painted_calibration
from support.robot import Faults, PtyRobot
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.files.atomic_files import FREE_FLOOR_BYTES
from tacshade_edge.quoting import counted
from tacshade_edge.stitching.stitch_file import PRESSES, SESSION
from tools.faults.rig import (
    BASE,
    FAULTS,
    Cell,
    Fault,
    Seen,
    SkippedError,
    fault,
    frames_of,
    pause,
    small_disk,
)

# The broker disappears, stalls, refuses or is shared, and requests that nobody should send.


AWAY_S = 2.0
STALL_S = 6.0
FLOOD = 5000


@fault("broker killed, and back")
def killed(cell: Cell) -> Seen:
    cell.start()
    before = cell.frames()["failed"]
    since_s = cell.mark()
    cell.broker.kill()
    detected_s = cell.reported("connection lost|Connection refused", since_s)
    pause(AWAY_S)
    cell.broker.start()
    recovered_s = cell.maps_again()
    lost = cell.frames()["failed"] - before
    return Seen(
        f"{counted(lost, 'frame')}, counted as failed",
        "log, `health.mqtt.losses`",
        detected_s,
        recovered_s,
    )


@fault(f"broker stalls for {STALL_S:.0f} s")
def stalled(cell: Cell) -> Seen:
    """The broker neither reads nor answers, but the connection stays open."""
    cell.start()
    before = cell.frames()
    since_s = cell.mark()
    cell.broker.stall()
    detected_s = None
    while (at_s := time.monotonic() - since_s) < STALL_S:
        if detected_s is None and "connection lost" in cell.new_log():
            detected_s = at_s
        pause(0.02)
    cell.broker.resume()
    recovered_s = cell.maps_again()
    after = cell.frames()
    superseded, failed = (after[name] - before[name] for name in ("superseded", "failed"))
    assert superseded + failed > 0
    return Seen(
        f"{counted(superseded, 'frame')} superseded, {failed} failed, all counted",
        "log, `health`",
        detected_s,
        recovered_s,
    )


@fault("broker stalls until the connection is lost")
def network_stalls(cell: Cell) -> Seen:
    cell.start()
    before = cell.frames()["failed"]
    since_s = cell.mark()
    cell.broker.stall()
    detected_s = cell.reported("connection lost", since_s)
    cell.broker.resume()
    recovered_s = cell.maps_again()
    lost = cell.frames()["failed"] - before
    return Seen(
        f"{counted(lost, 'frame')}, counted as failed",
        "log, `health.mqtt.losses`",
        detected_s,
        recovered_s,
    )


@fault("broker denies publishing")
def denied(cell: Cell) -> Seen:
    rules = cell.folder / "acl"
    rules.write_text("topic read #\ntopic write tacshade/other/#\n")
    cell.serve(more=(f"acl_file {rules}",))
    began_s = cell.start(streams=False)
    detected_s = cell.reported("Not authorized", began_s)
    cell.reported("source streaming", began_s)
    assert cell.seen.of(f"{BASE}/height") == []
    return Seen("all maps, counted as failed", "log, `health.mqtt.refused`; `doctor`", detected_s)


@fault("a second daemon, same sensor_id and folders")
def same_id(cell: Cell) -> Seen:
    cell.start()
    count = cell.session()
    with cell.second("in use by") as detected_s:
        pause(3.0)
    recovered_s = cell.maps_again()
    cell.presses(count)
    return Seen("no press", "both logs", detected_s, recovered_s)


@fault(f"{FLOOD} requests at once")
def flood(cell: Cell) -> Seen:
    cell.start()
    cell.mark()
    for number in range(FLOOD):
        cell.seen.publish(
            f"{BASE}/req/profile", json.dumps({"profile": f"x{number}\n\x1b[31m"}).encode(), 0
        )

    def answered() -> bool:
        # Only a few answers may wait for the broker, so one may be missing.
        cell.seen.publish(f"{BASE}/req/status", b"{}")
        pause(0.1)
        return any(b'"ok":true' in answer for answer in cell.seen.of(f"{BASE}/res/status"))

    answered_s = cell.until(answered, 30, "an answer to a request for the status")
    cell.maps_again()
    lines = cell.new_log().splitlines()
    assert len(lines) < 60, len(lines)
    assert not any("\x1b" in line for line in lines)
    cell.frames()
    where = f"answers; {len(lines)} lines of log"
    return Seen("requests over 16 that wait, refused as busy", where, None, answered_s)


# The robot's line, the frames, the calibration and the settings;
# the guest tests a camera's own faults.


def _robot(cell: Cell, faults: Faults | None = None) -> PtyRobot:
    """Start a robot and the daemon, and wait until their clocks agree."""
    link = Path(f"/dev/shm/tacshade-fault-{os.getpid()}")
    robot: PtyRobot = cell.enter(PtyRobot(link, rate_hz=100, faults=faults))
    cell.start(cell.settings(f"serial: {{device: {link}}}\n"))
    _synchronised(cell)
    return robot


def _synchronised(cell: Cell) -> float:
    return cell.until(
        lambda: cell.last("status/serial").get("sync") == "two-way", 30, "synchronised"
    )


@fault("serial line pulled, and back")
def unplugged(cell: Cell) -> Seen:
    robot = _robot(cell)
    since_s = cell.mark()
    robot.unplug()
    detected_s = cell.reported("serial away", since_s)
    pause(AWAY_S)
    robot.plug()
    recovered_s = _synchronised(cell)
    lost = cell.last("health")["serial"]["poses_lost"]
    where = "log, `status/serial`, EVT to the robot"
    return Seen(f"{counted(lost, 'pose')} so far, counted", where, detected_s, recovered_s)


@fault("robot restarts")
def restarts(cell: Cell) -> Seen:
    """Its clock begins anew."""
    robot = _robot(cell, Faults(reboot_s=6.0))
    cell.mark()
    boots = robot.counts.boots
    cell.until(lambda: robot.counts.boots > boots, 20, "a reboot")
    since_s = time.monotonic()
    detected_s = cell.reported("the robot sent a greeting", since_s)
    recovered_s = cell.reported("sync two-way", since_s)
    return Seen(
        "poses until the clocks agree again", "log, `status/serial`", detected_s, recovered_s
    )


@fault("a tenth of the robot's lines damaged")
def noise(cell: Cell) -> Seen:
    _robot(cell, Faults(damage=0.1))
    pause(3.0)
    cell.frames()
    serial = cell.last("health")["serial"]
    assert serial["damaged"] > 0
    assert serial["poses"] > 100
    return Seen(
        f"{counted(serial['damaged'], 'line')}, counted; none taken for another", "`health.serial`"
    )


@fault("robot falls silent")
def silent(cell: Cell) -> Seen:
    _robot(cell).stop_talking()
    detected_s = cell.until(
        lambda: cell.last("status/serial").get("state") == "silent", 20, "silent"
    )
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
    detected_s = cell.reported("source unusable", since_s)
    show(shown)
    where = "log, `state` degraded, `status/camera`"
    return Seen("those frames, counted as invalid", where, detected_s, cell.maps_again())


def _reloaded(cell: Cell, pattern: str) -> float:
    """Reload the settings and wait for a line of the log; return the seconds."""
    since_s = cell.mark()
    cell.daemon.send_signal(signal.SIGHUP)
    return cell.reported(pattern, since_s)


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


# Disks, and files with state.


FLOOR_MB = FREE_FLOOR_BYTES >> 20


def _fill(disk: Path) -> Path:
    """Fill the disk to below the daemon's floor; return the file that does."""
    filler = disk / "filler"
    with filler.open("wb") as stream:
        for _ in range((shutil.disk_usage(disk).free >> 20) - FLOOR_MB + 5):
            stream.write(bytes(1 << 20))
    return filler


def _begun(cell: Cell, name: str) -> float:
    """Begin a session; return the seconds that this took."""
    since_s = time.monotonic()
    answer = cell.ask("stitch", action="begin", name=name)
    assert answer["ok"], answer
    return time.monotonic() - since_s


@fault("disk full while recording")
def full_while_recording(cell: Cell) -> Seen:
    disk = cell.enter(small_disk(cell.folder / "recs", FLOOR_MB + 40))
    cell.start()
    cell.record(frames=20)
    since_s = cell.mark()
    filler = _fill(disk)
    cell.until(
        lambda: cell.last("status/recorder").get("state") == "stopped", 30, "the recording's end"
    )
    detected_s = time.monotonic() - since_s
    status = cell.last("status/recorder")
    assert status["ending_code"] == "disk_full", status
    read = len(frames_of(disk / "r")[0])
    assert read == status["frames"]
    cell.maps_again()
    filler.unlink()
    since_s = time.monotonic()
    assert cell.ask("record", action="start", seconds=1, name="r2")["ok"]
    lost = f"{counted(status['dropped'], 'frame')}, counted; all {read} before are there"
    return Seen(lost, "`status/recorder`, log", detected_s, time.monotonic() - since_s)


@fault("a recording read while it is written")
def read_while_recording(cell: Cell) -> Seen:
    """It is read repeatedly from the beginning."""
    cell.start()
    reads, most = 12, 0
    cell.record()
    path = cell.folder / "recs/r"
    for _ in range(reads):
        stamps_ns, damage = frames_of(path)
        assert not damage, damage
        assert len(stamps_ns) >= most, (len(stamps_ns), most)
        most = len(stamps_ns)
        pause(0.2)
    assert most > 30, most
    assert cell.ask("record", action="stop")["ok"]
    cell.until(lambda: cell.last("status/recorder").get("state") != "recording", 20, "its end")
    status = cell.last("status/recorder")
    stamps_ns, damage = frames_of(path)
    assert (len(stamps_ns), damage, status["dropped"]) == (status["frames"], [], 0), (
        damage,
        status,
    )
    return Seen(f"nothing in {reads} readings; each has what was written until then", "")


@fault("disk full at BEGIN")
def full_at_begin(cell: Cell) -> Seen:
    disk = cell.enter(small_disk(cell.folder / "maps", FLOOR_MB + 20))
    cell.start()
    filler = _fill(disk)
    since_s = cell.mark()
    answer = cell.ask("stitch", action="begin", name="one")
    detected_s = time.monotonic() - since_s
    assert answer.get("reason_code") == "disk_full", answer
    filler.unlink()
    return Seen("nothing", "the answer to BEGIN", detected_s, _begun(cell, "one"))


@fault("disk full in a session")
def full_in_a_session(cell: Cell) -> Seen:
    disk = cell.enter(small_disk(cell.folder / "maps", FLOOR_MB + 20))
    cell.start()
    cell.session()
    filler = _fill(disk)
    detected_s = cell.reported("did not add a settled contact", cell.mark())
    presses = cell.ask("stitch", action="status")["result"]["presses"]
    filler.unlink()
    since_s = time.monotonic()
    cell.presses(presses + 1)
    missed = cell.last("status/stitching")["missed"]
    where = "log, `status/stitching.missed`"
    return Seen(
        f"{counted(missed, 'press')}, each refused", where, detected_s, time.monotonic() - since_s
    )


@fault("a bit flipped in a session's presses")
def flipped_bit(cell: Cell) -> Seen:
    """The bit is in the first press; no daemon runs meanwhile."""
    cell.start()
    count = cell.session(count=4)
    cell.kill()
    path = cell.folder / "maps/one" / PRESSES
    content = bytearray(path.read_bytes())
    content[200] ^= 4
    path.write_bytes(content)
    cell.mark()
    began_s = cell.start()
    detected_s = cell.reported("are damaged or incomplete", began_s)
    found = cell.presses(1)
    assert found >= count - 1, (found, count)
    assert path.with_name(f"{PRESSES}.damaged-1").read_bytes() == content
    return Seen(
        f"1 press of {count}; the file is kept beside",
        "log",
        detected_s,
        time.monotonic() - began_s,
    )


@fault("a session's description cut")
def cut_description(cell: Cell) -> Seen:
    """No daemon runs meanwhile."""
    cell.start()
    cell.session(count=4)
    cell.kill()
    path = cell.folder / "maps/one" / SESSION
    path.write_bytes(path.read_bytes()[:40])
    cell.mark()
    began_s = cell.start()
    detected_s = cell.reported("skipping a session", began_s)
    _begun(cell, "two")
    assert (cell.folder / "maps/one" / PRESSES).stat().st_size > 0
    lost = "the session is not resumed; its presses stay"
    return Seen(lost, "log", detected_s, time.monotonic() - began_s)


# The daemon's process; tests/service has its watchdog and restarts under systemd.


FROZEN_S = 5.0
YEAR_S = 365 * 86_400


@fault("daemon killed (-9) in a session and a recording")
def daemon_killed(cell: Cell) -> Seen:
    cell.start()
    cell.session()
    cell.record()
    frames, count = cell.last("status/recorder")["frames"], cell.last("status/stitching")["presses"]
    since_s = cell.mark()
    cell.kill()
    cell.until(lambda: cell.seen.of(f"{BASE}/state")[-1:] == [b"offline"], 30, "the last will")
    detected_s = time.monotonic() - since_s
    assert len(frames_of(cell.folder / "recs/r")[0]) >= frames
    cell.mark()
    began_s = cell.start()
    assert cell.presses(1) >= count
    return Seen(
        "nothing that was reported", "`state` offline", detected_s, time.monotonic() - began_s
    )


@fault(f"daemon gets no processor for {FROZEN_S:.0f} s")
def frozen(cell: Cell) -> Seen:
    cell.start()
    before = cell.frames()["captured"]
    cell.daemon.send_signal(signal.SIGSTOP)
    pause(FROZEN_S)
    cell.daemon.send_signal(signal.SIGCONT)
    recovered_s = cell.maps_again()
    assert cell.frames()["captured"] > before
    return Seen(
        "what the camera showed meanwhile", "`health.source_dropped` of a camera", None, recovered_s
    )


@fault("wall clock steps by a day, 10 and 100 years")
def clock_steps(cell: Cell) -> Seen:
    """It steps both ways while the daemon records and has a session."""
    steps = cell.folder / "steps"
    steps.mkdir()
    offset = steps / "offset_s"
    (steps / "sitecustomize.py").write_text(
        "import pathlib, time\n"
        f"offset, wall_ns = pathlib.Path({str(offset)!r}), time.time_ns\n"
        "time.time_ns = lambda: max(0, wall_ns() + int(offset.read_text() or 0) * 10**9)\n"
        "time.time = lambda: time.time_ns() / 1e9\n"
    )
    offset.write_text("0")
    cell.start(environment={"PYTHONPATH": f"{steps}:{os.environ.get('PYTHONPATH', '')}"})
    count = cell.session()
    cell.record(frames=0)
    slowest_s = 0.0
    for seconds in (86_400, -86_400, 10 * YEAR_S, -10 * YEAR_S, -100 * YEAR_S, 0):
        (steps / "beside").write_text(str(seconds))
        (steps / "beside").replace(offset)
        slowest_s = max(slowest_s, cell.maps_again())
        cell.frames()
        wall_s = cell.last("health")["wall_ns"] / 1e9
        assert abs(wall_s - max(0.0, time.time() + seconds)) < 30, (wall_s, seconds)
        count = cell.presses(count + 1)
    assert cell.ask("record", action="stop")["ok"]
    stamps_ns, _ = frames_of(cell.folder / "recs/r")
    assert stamps_ns == sorted(set(stamps_ns))
    assert len(stamps_ns) == cell.last("status/recorder")["frames"]
    assert "Traceback" not in cell.log(), cell.log()[-300:]
    cell.kill()
    cell.start()
    assert cell.presses(1) >= count
    where = "`doctor` when the clock is unset"
    return Seen("nothing; `wall_ns` steps, `t_ns` does not", where, None, slowest_s)


@fault("SIGTERM during the start")
def stopped_early(cell: Cell) -> Seen:
    path, codes = cell.settings(), []
    for after_s in (0.05, 0.3, 0.6, 0.9, 1.2, 1.8):
        process = cell.spawn(path)
        pause(after_s)
        process.send_signal(signal.SIGTERM)
        codes.append(cell.ended(process))
    # Before the program's first line, the kernel ends the process,
    # and systemd counts this as a clean exit.
    assert set(codes) <= {0, -signal.SIGTERM}, codes
    return Seen("nothing", f"exit codes {', '.join(map(str, codes))}")


HEAD = ("fault", "detected s", "recovered s", "lost", "reported where")


def run_one(fault: Fault) -> tuple[str, ...]:
    """Run a fault with a new daemon and broker; return its cells.

    Raises AssertionError if a promise is broken.
    """
    with TemporaryDirectory() as name, Cell(Path(name) / "cell") as cell:
        seen = fault(cell)
    times = (
        "" if value is None else f"{value:.1f}" for value in (seen.detected_s, seen.recovered_s)
    )
    return (*times, seen.lost, seen.where)


def run(
    words: list[str] | None, report: Callable[[str], None]
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield the rows of the table, each with its problem or an empty string."""
    for name, one in FAULTS.items():
        if words and not any(word in name for word in words):
            continue
        began_s, problem = time.monotonic(), ""
        try:
            row = (name, *run_one(one))
        except SkippedError as skipped:
            row = (name, "", "", f"not tried: {skipped}", "")
        except Exception as error:  # noqa: BLE001
            row = (name, "", "", "**not as promised**", "")
            problem = f"{name}: {error or type(error).__name__}\n{traceback.format_exc(limit=-2)}"
        report(f"{time.monotonic() - began_s:5.1f} s {' | '.join(row)}")
        yield row, problem


def table(rows: list[tuple[str, ...]]) -> str:
    """Write the table."""
    lines = ["| " + " | ".join(HEAD) + " |", "|---|---:|---:|---|---|"]
    return "\n".join(
        (
            *lines,
            *("| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows),
        )
    )
