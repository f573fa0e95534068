"""Faults of the daemon's process; the guest tests its watchdog and restarts under systemd (tests/service)."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import time
from pathlib import Path

from tacshade_edge.storage.recording.recording import Recording
from tools.faults.rig import BASE, SENSOR_ID, Cell, Seen, ended, pause
from tools.testbed.patience import wait_until
from tools.testbed.processes import is_there, suspend

FROZEN_S = 5.0
YEAR_S = 365 * 86_400


def killed(cell: Cell) -> Seen:
    """The daemon is killed while it records and has a session."""
    cell.serve()
    cell.start()
    count = cell.session("one")
    assert cell.ask("record", action="start", seconds=600, name="r")["ok"]
    cell.until(lambda: cell.last("status/recorder").get("frames", 0) > 30, 20, "a recording")
    told = cell.last("status/recorder")["frames"]
    count = max(count, cell.last("status/stitching")["presses"])
    since_s = cell.mark()
    cell.kill()
    cell.daemon = None
    cell.until(lambda: cell.seen.of(f"{BASE}/state")[-1:] == [b"offline"], 30, "the last will")
    detected_s = time.monotonic() - since_s
    recording, read = Recording(cell.folder / "recs/r"), 0
    while recording.read() is not None:
        read += 1
    assert read >= told, (read, told)
    since_s = cell.mark()
    cell.start()
    assert cell.presses(1) >= count
    return Seen(detected_s, time.monotonic() - since_s, "nothing that was told", "`state` offline")


def frozen(cell: Cell) -> Seen:
    """The daemon gets no processor time for a while."""
    cell.serve()
    cell.start()
    assert cell.daemon is not None
    before = cell.frames()
    cell.daemon.send_signal(signal.SIGSTOP)
    pause(FROZEN_S)
    cell.daemon.send_signal(signal.SIGCONT)
    recovered_s = cell.maps_again(time.monotonic())
    after = cell.frames()
    assert after["captured"] > before["captured"]
    return Seen(None, recovered_s, "what the camera showed meanwhile", "`health.source_dropped` of a camera")


def clock_steps(cell: Cell) -> Seen:
    """The wall clock steps by a day and by years, both ways, while it records and has a session."""
    steps = cell.folder / "steps"
    steps.mkdir()
    offset = steps / "offset_s"
    (steps / "sitecustomize.py").write_text(
        "import pathlib, time\n"
        f"offset, wall_ns = pathlib.Path({str(offset)!r}), time.time_ns\n"
        "time.time_ns = lambda: max(0, wall_ns() + int(offset.read_text() or 0) * 10**9)\n"
        "time.time = lambda: time.time_ns() / 1e9\n"
    )

    def step(seconds: int) -> None:
        beside = steps / "beside"
        beside.write_text(str(seconds))
        os.replace(beside, offset)

    step(0)
    cell.serve()
    cell.start(environment={"PYTHONPATH": str(steps)})
    count = cell.session("one")
    assert cell.ask("record", action="start", seconds=600, name="r")["ok"]
    slowest_s = 0.0
    for seconds in (86_400, -86_400, 10 * YEAR_S, -10 * YEAR_S, -100 * YEAR_S, 0):
        step(seconds)
        slowest_s = max(slowest_s, cell.maps_again(time.monotonic()))
        cell.frames()
        told_s = cell.last("health")["wall_ns"] / 1e9
        assert abs(told_s - max(0.0, time.time() + seconds)) < 30, (told_s, seconds)
        count = cell.presses(count + 1)
    assert cell.ask("record", action="stop")["ok"]
    recording, stamps_ns = Recording(cell.folder / "recs/r"), []
    while (frame := recording.read()) is not None:
        stamps_ns.append(frame.frame.t_ns)
    assert stamps_ns == sorted(set(stamps_ns))
    assert len(stamps_ns) == cell.last("status/recorder")["frames"]
    assert "Traceback" not in cell.log(), cell.log()[-300:]
    cell.kill()
    cell.start()
    assert cell.presses(1) >= count
    return Seen(None, slowest_s, "nothing; `wall_ns` steps, `t_ns` does not", "`doctor` when the clock is unset")


def stopped_early(cell: Cell) -> Seen:
    """The daemon gets SIGTERM at several moments of its start."""
    path = cell.settings()
    codes = []
    for after_s in (0.05, 0.3, 0.6, 0.9, 1.2, 1.8):
        process = cell.spawn(path)
        pause(after_s)
        process.send_signal(signal.SIGTERM)
        codes.append(ended(process))
    # Before the program's first line, the kernel ends the process, and systemd counts this as a clean exit.
    assert set(codes) <= {0, -signal.SIGTERM}, codes
    return Seen(None, None, "nothing", f"exit codes {', '.join(map(str, codes))}")


def little_memory(cell: Cell) -> Seen:
    """The daemon runs under a `ulimit -v` of 500 MB."""
    limit = 500 << 20
    began_s = time.monotonic()
    process = cell.spawn(cell.settings(), before=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)))
    code = ended(process, 30)
    said = cell.log()
    assert code > 0, f"ended by signal {-code}: {said[-300:]!r}"
    assert "Traceback" not in said, said[-300:]
    return Seen(time.monotonic() - began_s, None, "it does not run", f"one line, exit code {code}")


def shared_folder(cell: Cell) -> Seen:
    """A second daemon with another sensor_id uses the same folder for sessions."""
    cell.serve()
    cell.start()
    count = cell.session("one")
    text = cell.settings(name="other.yaml").read_text().replace(f"sensor_id: {SENSOR_ID}", "sensor_id: other")
    path = cell.folder / "other.yaml"
    path.write_text(text)
    began_s = time.monotonic()
    other = cell.spawn(path, "other")
    try:
        while "in use by" not in cell.log("other") and time.monotonic() < began_s + 15:
            pause(0.02)
        detected_s = time.monotonic() - began_s
        assert "in use by 'sensor finger, process" in cell.log("other"), cell.log("other")[-300:]
        other.kill()
        other.wait()
        assert cell.presses(count + 2) > count
    finally:
        other.kill()
        other.wait()
    return Seen(detected_s, None, "nothing", "log: who holds it")


def one_of_several(cell: Cell) -> Path:
    """Write settings in the form for several sensors, which gives a supervisor and a process for this sensor."""
    path = cell.folder / "several.yaml"
    path.write_text(
        "profile: fast\nsensors:\n"
        f"  {SENSOR_ID}:\n    calibration: c.npz\n    source: {{kind: files, path: images, fps: 60, loop: true}}\n"
        f"mqtt: {{host: 127.0.0.1, port: {cell.broker.port}}}\n"
        "recorder: {folder: recs}\nstitching: {folder: maps}\n"
    )
    return path


def part_of(cell: Cell) -> int:
    """Find the process id of the only sensor."""
    assert cell.daemon is not None
    found = subprocess.run(("pgrep", "-P", str(cell.daemon.pid)), capture_output=True, check=True)
    return int(found.stdout)


def part_stopped(cell: Cell) -> Seen:
    """One sensor's process gets SIGTERM."""
    cell.serve()
    cell.start(one_of_several(cell))
    since_s = cell.mark()
    os.kill(part_of(cell), signal.SIGTERM)
    detected_s = cell.told("a signal ended its process; restarting", since_s)
    return Seen(detected_s, cell.maps_again(time.monotonic()), "frames meanwhile", "log, `STATUS`")


def part_left(cell: Cell) -> Seen:
    """The supervisor gets SIGKILL while SIGSTOP holds its sensor's process."""
    cell.serve()
    cell.start(one_of_several(cell))
    part = part_of(cell)
    suspend(part)
    cell.kill()
    cell.daemon = None
    since_s = time.monotonic()
    try:
        wait_until(lambda: not is_there(part), 20, "it ends with its supervisor")
    finally:
        if is_there(part):
            os.kill(part, signal.SIGKILL)
    return Seen(time.monotonic() - since_s, None, "it ends", "`state`")


def few_files(cell: Cell) -> Seen:
    """The daemon runs under a `ulimit -n` of 12."""
    began_s = time.monotonic()
    process = cell.spawn(cell.settings(), before=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (12, 12)))
    assert ended(process, 30) == 78, cell.log()[-300:]
    assert "expected at least 128" in cell.log(), cell.log()[-300:]
    assert "Traceback" not in cell.log(), cell.log()[-300:]
    return Seen(time.monotonic() - began_s, None, "it does not run", "one line, exit code 78")


FAULTS = {
    "daemon killed (-9) in a session and a recording": killed,
    f"daemon gets no processor for {FROZEN_S:.0f} s": frozen,
    "wall clock steps by a day, 10 and 100 years": clock_steps,
    "SIGTERM during the start": stopped_early,
    "500 MB of address space": little_memory,
    "12 open files": few_files,
    "SIGTERM to the process of one of several sensors": part_stopped,
    "supervisor killed (-9) while a sensor is stopped": part_left,
    "two daemons, one folder for sessions": shared_folder,
}
