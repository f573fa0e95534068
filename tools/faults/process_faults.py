"""Faults of the daemon's process; the guest tests its watchdog and restarts under systemd (tests/service)."""

from __future__ import annotations

import os
import resource
import signal
import time

from tools.faults.rig import BASE, Cell, Seen, fault, frames_of, pause

FROZEN_S = 5.0
YEAR_S = 365 * 86_400


@fault("daemon killed (-9) in a session and a recording")
def killed(cell: Cell) -> Seen:
    cell.start()
    cell.session()
    cell.record()
    told, count = cell.last("status/recorder")["frames"], cell.last("status/stitching")["presses"]
    since_s = cell.mark()
    cell.kill()
    cell.until(lambda: cell.seen.of(f"{BASE}/state")[-1:] == [b"offline"], 30, "the last will")
    detected_s = time.monotonic() - since_s
    assert len(frames_of(cell.folder / "recs/r")[0]) >= told
    cell.mark()
    began_s = cell.start()
    assert cell.presses(1) >= count
    return Seen("nothing that was told", "`state` offline", detected_s, time.monotonic() - began_s)


@fault(f"daemon gets no processor for {FROZEN_S:.0f} s")
def frozen(cell: Cell) -> Seen:
    cell.start()
    before = cell.frames()["captured"]
    cell.daemon.send_signal(signal.SIGSTOP)
    pause(FROZEN_S)
    cell.daemon.send_signal(signal.SIGCONT)
    recovered_s = cell.maps_again()
    assert cell.frames()["captured"] > before
    return Seen("what the camera showed meanwhile", "`health.source_dropped` of a camera", None, recovered_s)


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
        told_s = cell.last("health")["wall_ns"] / 1e9
        assert abs(told_s - max(0.0, time.time() + seconds)) < 30, (told_s, seconds)
        count = cell.presses(count + 1)
    assert cell.ask("record", action="stop")["ok"]
    stamps_ns, _ = frames_of(cell.folder / "recs/r")
    assert stamps_ns == sorted(set(stamps_ns))
    assert len(stamps_ns) == cell.last("status/recorder")["frames"]
    assert "Traceback" not in cell.log(), cell.log()[-300:]
    cell.kill()
    cell.start()
    assert cell.presses(1) >= count
    told = "`doctor` when the clock is unset"
    return Seen("nothing; `wall_ns` steps, `t_ns` does not", told, None, slowest_s)


@fault("SIGTERM during the start")
def stopped_early(cell: Cell) -> Seen:
    path, codes = cell.settings(), []
    for after_s in (0.05, 0.3, 0.6, 0.9, 1.2, 1.8):
        process = cell.spawn(path)
        pause(after_s)
        process.send_signal(signal.SIGTERM)
        codes.append(cell.ended(process))
    # Before the program's first line, the kernel ends the process, and systemd counts this as a clean exit.
    assert set(codes) <= {0, -signal.SIGTERM}, codes
    return Seen("nothing", f"exit codes {', '.join(map(str, codes))}")


def _limited(cell: Cell, what: int, limit: int) -> Seen:
    began_s = time.monotonic()
    process = cell.spawn(cell.settings(), before=lambda: resource.setrlimit(what, (limit, limit)))
    code = cell.ended(process)
    assert code > 0, f"ended by signal {-code}: {cell.log()[-300:]!r}"
    return Seen("it does not run", f"one line, exit code {code}", time.monotonic() - began_s)


@fault("500 MB of address space")
def little_memory(cell: Cell) -> Seen:
    return _limited(cell, resource.RLIMIT_AS, 500 << 20)


@fault("12 open files")
def few_files(cell: Cell) -> Seen:
    seen = _limited(cell, resource.RLIMIT_NOFILE, 12)
    assert "expected at least 128" in cell.log(), cell.log()[-300:]
    return seen
