"""SIGTERM and SIGKILL at every phase of the daemon's start and stop: it ends as it should,
nothing acknowledged is lost, nothing stays behind, and the next start goes on.

A phase is a call of a named function: the daemon sends itself the signal when it comes there.
One daemon after another works on the same files, records, has a session and a robot, and is
stopped; some with a broker that is away or stalls, and with requests that come too late.
"""

from __future__ import annotations

import fcntl
import json
import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal

from support.patience import patience, wait_until
from support.robot import PtyRobot
from tools.faults.kills import Killed
from tools.faults.rig import BASE, Cell, pause

START: Final = (
    "tacshade_edge.cli.entry:entry",
    "tacshade_edge.settings:<module>",
    "tacshade_edge.daemon.app:<module>",
    "tacshade_edge.daemon.named_files:check_files",
    "tacshade_edge.calibration.loading:find_calibration",
    "tacshade_edge.daemon.app:App.__init__",
    "tacshade_edge.daemon.app:App.run",
    "tacshade_edge.mqtt.client:BrokerSession.start",
    "tacshade_edge.daemon.record_thread:RecordThread._run",
    "tacshade_edge.stitching.session_worker:Sessions._resume",
    "tacshade_edge.robot.serial_line:SerialChannel._on_open",
    "tacshade_edge.mqtt.link:MqttLink._on_accepted",
    "tacshade_edge.pipeline.pipeline:Pipeline.start",
    "tacshade_edge.daemon.app:App._loop",
)
STOP: Final = (
    "tacshade_edge.daemon.app:App._shut_down",
    "tacshade_edge.robot.robot:Robot.stop",
    "tacshade_edge.pipeline.pipeline:Pipeline.stop",
    "tacshade_edge.pipeline.ledger:FrameLedger.close",
    "tacshade_edge.daemon.live_recorder:LiveRecorder.stop",
    "tacshade_edge.recording.recorder:RecordingWriter.finish",
    "tacshade_edge.files.atomic_files:_write",
    "tacshade_edge.stitching.session_worker:Sessions.stop",
    "tacshade_edge.stitching.stitch_file:StitchFile.close",
    "tacshade_edge.mqtt.link:MqttLink.stop",
    "tacshade_edge.mqtt.outgoing:Outgoing._end",
    "tacshade_edge.mqtt.outgoing:Outgoing.wait_until_away",
    "tacshade_edge.mqtt.link:MqttLink._give_up",
    "tacshade_edge.cli.entry:leave",
)
NUMBERS: Final = (signal.SIGTERM, signal.SIGKILL)
BROKERS: Final = ("away", "stalls")
STOPPING: Final = STOP[0]
LATE: Final = ("status", "record", "reference", "stitch", "profile")
"""Requests that come while the daemon stops; each has to be answered."""
FRAMES: Final = 5
UNFINISHED: Final = ("*.part", "*.new", "*.tmp")
HOOK: Final = """
import os, sys, threading, time
after, place, action, go = os.environ["TACSHADE_END"].split(" ")

def at(frame, name):
    code = frame.f_code
    module, _, function = name.partition(":")
    # By name first: this is asked at every call.
    return code.co_qualname == function and frame.f_globals.get("__name__") == module

def look(frame, event, _):
    global after
    if event != "call":
        return
    if after and at(frame, after):
        after = ""
    if not after and at(frame, place):
        sys.setprofile(None)
        threading.setprofile(None)
        after = "never again"
        if action == "wait":
            open(go + ".reached", "w").close()
            while not os.path.exists(go):
                time.sleep(0.01)
        else:
            os.kill(os.getpid(), int(action))

threading.setprofile(look)
sys.setprofile(look)
"""


@dataclass(frozen=True, slots=True)
class End:
    """One end: where the daemon is, which signal comes there, and what is wrong beside it."""

    phase: Literal["start", "stop"]
    place: str
    action: str
    broker: str = ""

    def __str__(self) -> str:
        what = self.action if self.action == "wait" else signal.Signals(int(self.action)).name
        beside = f", the broker {self.broker}" if self.broker else ""
        return f"{self.phase}, {self.place}: {what}{beside}"


def ends() -> Iterator[End]:
    """Each phase with each signal; starts alternate with stops, whose daemons begin as theirs."""
    for began, stopped in zip(START, STOP, strict=True):
        for number in NUMBERS:
            yield End("start", began, f"{number:d}")
        for number in NUMBERS:
            yield End("stop", stopped, f"{number:d}")
    for broker in BROKERS:
        for number in NUMBERS:
            yield End("stop", "tacshade_edge.mqtt.link:MqttLink.stop", f"{number:d}", broker)
    yield End("stop", STOPPING, "wait")


def chosen(words: list[str] | None) -> Iterator[End]:
    """The ends whose names have one of the words."""
    for end in ends():
        if not words or any(word in str(end) for word in words):
            yield end


class Ended:
    """Daemons that share files, and how each ended."""

    def __init__(self, cell: Cell) -> None:
        self._cell, self._killed = cell, Killed(cell)
        self._shared = set[Path]()
        self.hook = cell.folder / "hook"
        self.hook.mkdir()
        (self.hook / "sitecustomize.py").write_text(HOOK)
        self._link = Path(f"/dev/shm/tacshade-ends-{os.getpid()}")
        cell.enter(PtyRobot(self._link, rate_hz=100))
        self.count = Counter[str]()

    @property
    def problems(self) -> list[str]:
        """What was not as it should be."""
        return self._killed.problems

    @property
    def acknowledged(self) -> Counter[str]:
        """What was acknowledged, and looked for after the end."""
        return self._killed.said

    def one(self, end: End, number: int) -> None:
        """Start a daemon, end it, and look at what it leaves."""
        before = len(self.problems)
        cell = self._cell
        self._killed.forget()
        go = self.hook / f"go-{number}"
        after = STOPPING if end.phase == "stop" else ""
        environment = {
            "PYTHONPATH": f"{self.hook}:{os.environ.get('PYTHONPATH', '')}",
            "TACSHADE_END": f"{after} {end.place} {end.action} {go}",
        }
        serial = f"serial: {{device: {self._link}}}\n"
        cell.start(cell.settings(serial), streams=False, environment=environment)
        if end.phase == "stop":
            self._work(number)
            self._shared = shared_memory(cell.daemon.pid)
            if end.broker:
                (cell.broker.kill if end.broker == "away" else cell.broker.stall)()
            cell.daemon.send_signal(signal.SIGTERM)
            if end.action == "wait":
                self._ask_late(go)
        code = cell.daemon.wait(patience(30))
        self.count[end.phase] += 1
        self._look(end, code)
        self.problems[before:] = [f"{end}: {problem}" for problem in self.problems[before:]]

    def _work(self, number: int) -> None:
        """Until the daemon records, has a session with presses, and hears the robot."""
        cell = self._cell
        cell.until(lambda: cell.last("contact"), 30, "the first frame")
        begun = {"action": "start", "seconds": 600, "name": f"n{number}"}
        cell.ask("record", **begun, transaction="record start")
        if not cell.last("status/stitching").get("name"):
            begun = {"action": "begin", "name": f"n{number}"}
            cell.ask("stitch", **begun, transaction="stitch begin")
        pressed = cell.last("status/stitching").get("presses", 0)
        cell.presses(pressed + 1)
        cell.until(lambda: cell.last("status/recorder").get("frames", 0) > FRAMES, 30, "frames")

    def _ask_late(self, go: Path) -> None:
        cell = self._cell
        reached = go.with_suffix(".reached")
        wait_until(reached.exists, 30, "the daemon stops")
        self._killed.hear()
        self._killed.forget()
        for verb in LATE:
            body = {"action": "stop"} if verb == "record" else {}
            cell.seen.publish(f"{BASE}/req/{verb}", json.dumps(body).encode())
        cell.seen.publish(f"{BASE}/req/reference", b"{}")
        pause(0.3)
        go.touch()
        cell.daemon.wait(patience(30))
        pause(0.2)
        unanswered = [verb for verb in LATE if not cell.seen.of(f"{BASE}/res/{verb}")]
        if unanswered:
            self.problems.append(f"no answer to {unanswered}")

    def _look(self, end: End, code: int) -> None:
        cell, said = self._cell, self.problems
        if end.broker == "away":
            cell.broker.start()
        elif end.broker:
            cell.broker.resume()
        killed = end.action == f"{signal.SIGKILL:d}"
        right = {-signal.SIGKILL} if killed else {0}
        if end.phase == "start" and not killed:
            right.add(-signal.SIGTERM)  # before the program has a handler
        if code not in right or "Traceback" in cell.new_log():
            said.append(f"exit code {code}: {cell.new_log()[-500:]}")
        cell.kill()
        said += [f"{name} is held" for name in locked(cell.folder)]
        said += [f"process {pid} is left" for pid in left(self.hook)]
        if shared := sorted(str(path) for path in self._shared if path.exists()):
            said.append(f"shared memory {shared} is left")
        if not killed and (parts := unfinished(cell.folder)):
            said.append(f"{parts} are left")
        wanted = ("stopped", "offline") if killed or end.broker or code else ("stopped",)
        states = cell.seen.of(f"{BASE}/state")
        if end.broker != "away" and (end.phase == "stop" or states):
            with_state = lambda: cell.seen.of(f"{BASE}/state")[-1].decode() in wanted  # noqa: E731
            try:
                wait_until(with_state, 30, f"state {wanted}")
            except AssertionError as error:
                said.append(f"{error}: {cell.seen.of(f'{BASE}/state')}")
        self._killed.look()


def locked(folder: Path) -> list[str]:
    """The files of locks that a process holds."""
    held = []
    for path in folder.rglob("*.owner"):
        with path.open("rb") as stream:
            try:
                fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                held.append(path.name)
    return held


def left(hook: Path) -> list[int]:
    """Processes that were started with this hook, and run."""
    found = []
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            content = path.read_bytes()
        except OSError:
            continue
        if f"PYTHONPATH={hook}:".encode() in content:
            found.append(int(path.parent.name))
    return found


def shared_memory(pid: int) -> set[Path]:
    """The shared memory that a process has mapped."""
    lines = Path(f"/proc/{pid}/maps").read_text().splitlines()
    return {Path(line.split(maxsplit=5)[5]) for line in lines if "/dev/shm/" in line}


def unfinished(folder: Path) -> list[str]:
    """Files that are not yet whole."""
    return sorted(
        str(path.relative_to(folder)) for what in UNFINISHED for path in folder.rglob(what)
    )


def run(wanted: list[End]) -> tuple[str, list[str]]:
    """Start and end a daemon for each; return a table and the problems."""
    with TemporaryDirectory() as name, Cell(Path(name) / "cell") as cell:
        cell.serve()
        ended = Ended(cell)
        for number, end in enumerate(wanted):
            before = len(ended.problems)
            ended.one(end, number)
            print("\n".join((str(end), *ended.problems[before:])), file=sys.stderr, flush=True)
    rows = ["| ended in its | times |", "|---|---:|"]
    rows += [f"| {phase} | {times} |" for phase, times in sorted(ended.count.items())]
    rows += ["", "| acknowledged, and looked for after the end | count |", "|---|---:|"]
    rows += [f"| {what} | {times} |" for what, times in sorted(ended.acknowledged.items())]
    rows += [f"| lost, left behind, or not as it should end | {len(ended.problems)} |"]
    return "\n".join(rows), ended.problems
