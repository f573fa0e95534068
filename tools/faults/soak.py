"""A long run in which something is always wrong: is memory flat, and is every frame accounted for?

The daemon reads 60 images a second of 640x480, drawn in advance. The broker restarts every `RESTART_S`, a subscriber
repeatedly reads nothing for `STALL_S`, one recording follows another, and a robot fills one session after another until
its map is full.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import socket
import statistics
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.protocol.serial.pose import PoseValues
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.tables.frame_table import read_table
from tools.testbed.daemon_rig import draw_rings, memory_mb
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.robot import PtyRobot

FPS = 60.0
RESTART_S, AWAY_S = 60.0, 2.0
STALL_S = 20.0
RECORD_S = 15.0
ADD_S = 0.25
PLACE_S, PLACES, PLACE_MM = 0.25, 21, 48.0
WARM_UP_S = 900.0
"""Time until some sessions have ended and the allocator has taken the memory it keeps; at most a quarter of the run."""
FLAT = 0.02
BASE = "tacshade/finger"


def place(at_s: float) -> PoseValues:
    """The robot's pose at a time: it visits the places of a square, which are further apart than a press is wide."""
    number = int(at_s / PLACE_S)
    return (number % PLACES * PLACE_MM, number // PLACES % PLACES * PLACE_MM, 60.0, 0.0, 1.0, 0.0, 0.0)


@dataclass(slots=True)
class Soaked:
    """The results of the run."""

    counts: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    resident_mb: list[tuple[float, float]] = field(default_factory=list)
    cycles: list[tuple[float, float]] = field(default_factory=list)
    """Begin and end of each session, in s."""
    last: dict[str, Any] = field(default_factory=dict)
    took_s: float = 0.0

    @property
    def warm_up_s(self) -> float:
        """The time at the beginning that does not count."""
        return min(WARM_UP_S, self.took_s / 4)

    @property
    def change(self) -> float:
        """Relative change of the daemon's least memory, from the first half after the warm-up to the second.

        A session's map and rasters come and go; a leak would add to the memory that remains without them.
        """
        middle_s = (self.warm_up_s + self.took_s) / 2
        first = [mb for at_s, mb in self.resident_mb if self.warm_up_s < at_s <= middle_s]
        second = [mb for at_s, mb in self.resident_mb if at_s > middle_s]
        return min(second) / min(first) - 1


class Soak:
    """The daemon and the programs that work with it."""

    def __init__(self, folder: Path, broker: Broker, seen: Subscriber, pid: int) -> None:
        self.out = Soaked()
        self._folder, self._broker, self._seen, self._pid = folder, broker, seen, pid
        self._began_s = time.monotonic()
        self._seq = -1
        self._session_since_s: float | None = None
        self._full = False
        self._recording = ""
        self._stop_asked = False
        self._down_since_s: float | None = None

    def run(self, seconds: float, still_runs: Callable[[], bool], progress: bool) -> None:
        """Run until the time is over."""
        next_s = {"add": 0.0, "restart": RESTART_S, "memory": 0.0, "told": 60.0, "record": 0.0}
        while (at_s := time.monotonic() - self._began_s) < seconds:
            if not still_runs():
                self.out.problems.append(f"the daemon ended after {at_s:.0f} s")
                return
            self._hear(at_s)
            due = [name for name, due_s in next_s.items() if at_s >= due_s]
            if "memory" in due:
                next_s["memory"] = at_s + 1.0
                self.out.resident_mb.append((at_s, memory_mb(self._pid)["resident"]))
            if "restart" in due and self._down_since_s is None:
                next_s["restart"] = at_s + RESTART_S
                self._broker.stop()
                self._down_since_s = at_s
                self.out.counts["restarts of the broker"] += 1
            if self._down_since_s is not None:
                if at_s > self._down_since_s + AWAY_S:
                    self._broker.start()
                    self._down_since_s = None
            else:
                if "add" in due:
                    next_s["add"] = at_s + ADD_S
                    self._stitch(at_s)
                if "record" in due:
                    next_s["record"] = at_s + 2.0
                    self._record(at_s)
            if progress and "told" in due:
                next_s["told"] = at_s + 60.0
                frames = self.out.last.get("frames", {})
                mb = self.out.resident_mb[-1][1]
                print(f"{at_s:6.0f} s {mb:6.1f} MB {frames} {dict(self.out.counts)}", file=sys.stderr, flush=True)
            threading.Event().wait(0.02)
        self.out.took_s = time.monotonic() - self._began_s

    def settle(self) -> None:
        """Take the last health message after the daemon's stop."""
        self._hear(time.monotonic() - self._began_s)

    def _ask(self, verb: str, body: dict[str, Any]) -> None:
        self._seen.publish(f"{BASE}/req/{verb}", json.dumps(body).encode(), 0)

    def _stitch(self, at_s: float) -> None:
        if self._session_since_s is None:
            self._ask("stitch", {"action": "begin"})
        elif self._full:
            self._ask("stitch", {"action": "end"})
        else:
            self._ask("stitch", {"action": "add"})

    def _record(self, at_s: float) -> None:
        self._ask("record", {"action": "start", "seconds": RECORD_S})

    def _hear(self, at_s: float) -> None:
        messages, self._seen.messages[:] = list(self._seen.messages), []
        for message in messages:
            topic = message.topic.removeprefix(f"{BASE}/")
            if topic == "height":
                self._take_height(bytes(message.payload))
            elif topic == "health":
                self._take_health(json.loads(message.payload))
            elif topic == "status/recorder":
                self._take_recorder(json.loads(message.payload))
            elif topic == "res/stitch":
                self._take_stitch(json.loads(message.payload), at_s)
            elif topic == "state":
                self.out.counts[f"state {message.payload.decode()}"] += 1

    def _take_height(self, payload: bytes) -> None:
        (seq,) = struct.unpack_from("<I", payload, 8)
        self.out.counts["height maps received"] += 1
        if seq <= self._seq:
            self.out.problems.append(f"frame {seq} after {self._seq}")
        self._seq = seq

    def _take_health(self, health: dict[str, Any]) -> None:
        frames = health["frames"]
        self.out.last = health
        self.out.counts["health messages"] += 1
        if frames["captured"] != sum(count for name, count in frames.items() if name != "captured"):
            self.out.problems.append(f"not accounted for: {frames}")

    def _take_recorder(self, status: dict[str, Any]) -> None:
        """Read a finished recording and delete it."""
        if status["state"] == "recording" or not status.get("folder"):
            return
        folder = Path(status["folder"])
        if not folder.is_dir():
            return
        rows = read_table(folder / "frames.csv")
        pictures = sum(1 for _ in folder.glob("*.png"))
        if not len(rows) == pictures == status["frames"]:
            self.out.problems.append(f"{folder.name}: {len(rows)} rows, {pictures} images, told {status['frames']}")
        self.out.counts["recordings"] += 1
        self.out.counts["frames recorded"] += len(rows)
        self.out.counts["frames not recorded, and told"] += status["dropped"]
        shutil.rmtree(folder)

    def _take_stitch(self, answer: dict[str, Any], at_s: float) -> None:
        if answer["ok"] and "press" in answer["result"]:
            self.out.counts["presses added"] += 1
        elif answer["ok"] and "used" in answer["result"]:
            assert self._session_since_s is not None
            self.out.cycles.append((self._session_since_s, at_s))
            self.out.counts["sessions filled and ended"] += 1
            self._session_since_s, self._full = None, False
            shutil.rmtree(self._folder / "maps" / answer["result"]["name"], ignore_errors=True)
        elif answer["ok"]:
            self._session_since_s = at_s
        else:
            code = answer["reason_code"]
            self.out.counts[f"stitch refused: {code}"] += 1
            self._full = self._full or code == "map_full"
            if code == "busy" and self._session_since_s is None:
                self._session_since_s = at_s
            elif code == "no_session":
                self._session_since_s, self._full = None, False


@contextlib.contextmanager
def never_reading(port: int) -> Iterator[Counter[str]]:
    """Subscribe to everything, read nothing for `STALL_S`, disconnect without notice, and repeat."""
    over, counts = threading.Event(), Counter[str]()

    def stall() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 2) as one:
                one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
                connect = b"\x00\x04MQTT\x04\x02\x00\x3c" + struct.pack(">H", 5) + b"stall"
                one.sendall(bytes((0x10, len(connect))) + connect)
                one.recv(4)
                topic = b"\x00\x01" + struct.pack(">H", 1) + b"#" + b"\x01"
                one.sendall(bytes((0x82, len(topic))) + topic)
                counts["stalls of a subscriber"] += 1
                over.wait(STALL_S)
            over.wait(1.0)

    thread = threading.Thread(target=stall)
    thread.start()
    try:
        yield counts
    finally:
        over.set()
        thread.join()


def run(seconds: float, *, progress: bool = False) -> Soaked:
    """Run the daemon for `seconds`."""
    with TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        draw_rings(folder)
        calibration_file.save(folder / "c.npz", make_calibration())
        broker = stack.enter_context(Broker(folder))
        link = folder / "line"
        robot = stack.enter_context(PtyRobot(link, rate_hz=100, binary=True, where=place))
        config = folder / "config.yaml"
        # The settings require a path below /dev.
        config.write_text(
            f"sensor_id: finger\nprofile: fast\ncalibration: c.npz\nsource: {{kind: simulated}}\n"
            f"serial: {{device: /dev/..{link}}}\nmqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            "recorder: {folder: recs}\nstitching: {folder: maps}\n"
        )
        program = (sys.executable, "-m", "tools.testbed.ring_daemon")
        log = stack.enter_context((folder / "log").open("w"))
        daemon = subprocess.Popen([*program, config, folder / "contact.npy", str(FPS)], stderr=log)
        stack.callback(daemon.kill)
        with Subscriber(broker.port, f"{BASE}/#") as seen, never_reading(broker.port) as stalls:
            soak = Soak(folder, broker, seen, daemon.pid)
            soak.run(seconds, lambda: daemon.poll() is None, progress)
            daemon.terminate()
            code = daemon.wait(20)
            threading.Event().wait(1.0)
            soak.settle()
        out = soak.out
        out.counts += stalls
        if code:
            out.problems.append(f"exit code {code}: {(folder / 'log').read_text()[-1000:]}")
        out.counts["lines of its log"] = len((folder / "log").read_text().splitlines())
        _judge(out, robot)
    return out


def _judge(out: Soaked, robot: PtyRobot) -> None:
    health = out.last
    frames, serial = health["frames"], health["serial"]
    if frames["pending"]:
        out.problems.append(f"{frames['pending']} frames pending after the stop")
    if out.counts["height maps received"] > frames["published"]:
        out.problems.append(f"{out.counts['height maps received']} received, {frames['published']} published")
    if serial["poses"] + serial["poses_lost"] > robot.told.poses:
        out.problems.append(f"{serial['poses']} poses and {serial['poses_lost']} lost of {robot.told.poses}")
    due = out.last["uptime_s"] * FPS
    if abs(frames["captured"] + health["source_dropped"] - due) > 3 * FPS:
        out.problems.append(f"{frames['captured']} captured, {health['source_dropped']} dropped, {due:.0f} were due")
    if abs(out.change) > FLAT:
        out.problems.append(f"memory changed by {out.change:+.1%}, expected within {FLAT:.0%}")


def table(out: Soaked) -> str:
    """Write a table of the load and its outcome."""
    health, megabytes = out.last, [mb for _, mb in out.resident_mb]
    serial = health["serial"]
    rows = ["| what | |", "|---|---:|", f"| seconds | {out.took_s:.0f} |"]
    rows += [f"| {what} | {count} |" for what, count in sorted(out.counts.items()) if count]
    rows += [f"| frames: {name} | {count} |" for name, count in health["frames"].items()]
    rows += [f"| frames that came before the last was read, and were counted | {health['source_dropped']} |"]
    rows += [f"| poses heard, lost and counted | {serial['poses']}, {serial['poses_lost']} |"]
    rows += [f"| resident MB, least, median, most | {min(megabytes):.0f}, {statistics.median(megabytes):.0f}, "]
    rows[-1] += f"{max(megabytes):.0f} |"
    for number, (began_s, ended_s) in enumerate(out.cycles):
        within = [mb for at_s, mb in out.resident_mb if began_s <= at_s <= ended_s] or [0.0]
        rows.append(f"| session {number + 1}: from s to s, most MB | {began_s:.0f}, {ended_s:.0f}, {max(within):.0f} |")
    change = f"{out.change:+.1%} after {out.warm_up_s:.0f} s"
    rows += [f"| memory, the least of the second half to that of the first | {change} |"]
    rows += [f"| not accounted for, out of order, lost | {len(out.problems)} |"]
    return "\n".join(rows)
