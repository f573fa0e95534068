"""A long run of a whole hand in which something is always wrong:
is memory flat, and is every frame accounted for?

Each of five fingers is a process that reads a ring of images drawn in advance. The broker restarts
every `RESTART_S`, the fingers record in turn, and a robot fills one session after another until its
map is full. A scraper reads Prometheus' page. One viewer reads everything that Foxglove's bridge
offers; another reads nothing, disconnects without notice and reconnects.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import struct
import subprocess
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from support.mqtt_rig import BridgeProcess, Broker, Subscriber
from support.robot import PtyRobot
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.lab.demo.demo_hand import make_calibration
from tacshade_edge.recording.frame_table import read_table
from tacshade_edge.robot.pose import PoseValues
from tools.testbed.daemon_rig import draw_rings, memory_mb

FINGERS = tuple(f"finger{k}" for k in range(5))
PRESSED = 2
FPS = 10.0
RESTART_S, AWAY_S, RECORD_S, STALL_S = 60.0, 2.0, 15.0, 20.0
PERIODS_S = {
    "restart": RESTART_S,
    "memory": 5.0,
    "progress": 60.0,
    "record": RECORD_S + 2.0,
    "scrape": 5.0,
    "add": 0.25,
}
PLACES, PLACE_MM = 21, 48.0
WARM_UP_S = 900.0
"""Time until some sessions have ended and allocators keep the memory that they have;
at most a quarter of the run.
"""
FLAT = 0.02


def place(at_s: float) -> PoseValues:
    """The robot's pose at a time: it visits the places of a square,
    which are further apart than a press is wide.
    """
    number = int(at_s / PERIODS_S["add"])
    return (
        number % PLACES * PLACE_MM,
        number // PLACES % PLACES * PLACE_MM,
        60.0,
        0.0,
        1.0,
        0.0,
        0.0,
    )


class Soak:
    """The run and its results."""

    def __init__(
        self, folder: Path, broker: Broker, seen: Subscriber, hand: subprocess.Popen[bytes]
    ) -> None:
        self.counts, self.problems = Counter[str](), list[str]()
        self.health: dict[str, dict[str, Any]] = {}
        self.resident_mb: dict[str, list[tuple[float, float]]] = {}
        """(time in s, memory in MB) of each process."""
        self.took_s = 0.0
        self._folder, self._broker, self._seen, self._hand = folder, broker, seen, hand
        self._last_seq: dict[str, int] = {}
        self._session = ""
        """Empty, `open`, or `full`."""
        self.over = threading.Event()

    def run(self, seconds: float, bridges: dict[str, BridgeProcess]) -> None:
        """Restart brokers, record, stitch, scrape and measure memory until the time is over."""
        began_s = time.monotonic()
        next_s = {what: min(10.0, period_s) for what, period_s in PERIODS_S.items()} | {
            "restart": RESTART_S
        }
        down_since_s: float | None = None
        while (at_s := time.monotonic() - began_s) < seconds:
            if self._hand.poll() is not None:
                self.problems.append(f"the hand ended after {at_s:.0f} s")
                break
            self.hear()
            if down_since_s is not None and at_s > down_since_s + AWAY_S:
                self._broker.start()
                down_since_s = None
            for what in [what for what, due_s in next_s.items() if at_s >= due_s]:
                next_s[what] = at_s + PERIODS_S[what]
                if what == "memory":
                    self._measure(at_s, bridges)
                elif what == "scrape":
                    self.scrape(bridges["prometheus"])
                elif what == "progress":
                    print(
                        f"{at_s:6.0f} s {dict(self.counts)} {self.problems}",
                        file=sys.stderr,
                        flush=True,
                    )
                elif down_since_s is not None:
                    continue
                elif what == "restart":
                    self._broker.stop()
                    down_since_s = at_s
                    self.counts["restarts of the broker"] += 1
                elif what == "record":
                    finger = FINGERS[self.counts["recordings"] % len(FINGERS)]
                    self._ask(finger, "record", {"action": "start", "seconds": RECORD_S})
                else:
                    action = {"": "begin", "open": "add", "full": "end"}[self._session]
                    self._ask(FINGERS[0], "stitch", {"action": action})
            self.over.wait(0.02)
        if down_since_s is not None:
            self._broker.start()
        self.took_s = time.monotonic() - began_s
        self.over.wait(15.0)  # so that all clients reconnect

    def view(self, url: str, reads: bool) -> None:
        """Subscribe to everything that the bridge offers, and read it only if `reads`,
        until the run is over.
        """
        who = "viewer" if reads else "viewer that reads nothing"
        while not self.over.is_set():
            with (
                contextlib.suppress(OSError, WebSocketException, TimeoutError),
                connect(
                    url,
                    subprotocols=[Subprotocol("foxglove.sdk.v1")],
                    max_size=None,
                    compression=None,
                    max_queue=1,
                ) as viewer,
            ):
                self.counts[f"{who}: connections"] += 1
                while not self.over.is_set():
                    text = viewer.recv(timeout=STALL_S)
                    if isinstance(text, str):
                        offered = json.loads(text).get("channels", ())
                        wanted = [{"id": one["id"], "channelId": one["id"]} for one in offered]
                        viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                        continue
                    self.counts[f"{who}: messages"] += 1
                    if not reads:
                        self.over.wait(STALL_S)
                        viewer.socket.close()
                        break
            self.over.wait(1.0)

    def scrape(self, bridge: BridgeProcess) -> set[str]:
        """Read Prometheus' page; return the fingers that it reports as up."""
        self.counts["pages of metrics"] += 1
        return set(re.findall(r'tacshade_up\{sensor="(\w+)"\} 1\.0', bridge.page()))

    def hear(self) -> None:
        """Check and count the messages received since the last call."""
        messages, self._seen.messages[:] = list(self._seen.messages), []
        for message in messages:
            _, name, topic = message.topic.split("/", 2)
            if name == "hand":
                self.counts["messages of the hand"] += topic.endswith("objects")
            elif topic == "height":
                (seq,) = struct.unpack_from("<I", message.payload, 8)
                if seq <= self._last_seq.get(name, -1):
                    self.problems.append(f"{name}: frame {seq} after {self._last_seq[name]}")
                self._last_seq[name] = seq
                self.counts["height maps received"] += 1
            elif topic == "health":
                frames = (health := json.loads(message.payload))["frames"]
                self.health[name] = health
                if frames["captured"] != sum(
                    count for outcome, count in frames.items() if outcome != "captured"
                ):
                    self.problems.append(f"{name}: not accounted for: {frames}")
            elif topic == "status/recorder":
                self._take_recording(json.loads(message.payload))
            elif topic == "res/stitch":
                self._take_answer(json.loads(message.payload))

    def _take_recording(self, status: dict[str, Any]) -> None:
        """Read a finished recording and delete it."""
        folder = Path(status.get("folder") or "/nowhere")
        if status["state"] == "recording" or not folder.is_dir():
            return
        rows, pictures = (
            len(read_table(folder / "frames.csv")),
            sum(1 for _ in folder.glob("*.png")),
        )
        if not rows == pictures == status["frames"]:
            self.problems.append(
                f"{folder.name}: {rows} rows, {pictures} images, {status['frames']} reported"
            )
        self.counts += {
            "recordings": 1,
            "frames recorded": rows,
            "frames not recorded": status["dropped"],
        }
        shutil.rmtree(folder)

    def _take_answer(self, answer: dict[str, Any]) -> None:
        """Follow the session."""
        result, code = answer.get("result") or {}, answer.get("reason_code")
        if not answer["ok"]:
            self.counts[f"stitch refused: {code}"] += 1
            states = {"map_full": "full", "no_session": "", "busy": self._session or "open"}
            self._session = states.get(str(code), self._session)
        elif "press" in result:
            self.counts["presses added"] += 1
        elif "used" in result:
            self.counts["sessions filled and ended"] += 1
            self._session = ""
            for folder in self._folder.glob(f"maps/**/{result['name']}"):
                shutil.rmtree(folder, ignore_errors=True)
        else:
            self._session = "open"

    def _ask(self, name: str, verb: str, body: dict[str, Any]) -> None:
        self._seen.publish(f"tacshade/{name}/req/{verb}", json.dumps(body).encode(), 0)

    def _measure(self, at_s: float, bridges: dict[str, BridgeProcess]) -> None:
        children = subprocess.run(
            ("pgrep", "-P", str(self._hand.pid)), capture_output=True, check=False
        ).stdout.split()
        named = {f"hand, process {pid}": pid for pid in (self._hand.pid, *map(int, children))}
        if self.resident_mb and not set(named) <= set(self.resident_mb):
            self.problems.append(f"another process after {at_s:.0f} s: {sorted(named)}")
        for process, pid in (
            named | {kind: bridge.process.pid for kind, bridge in bridges.items()}
        ).items():
            self.resident_mb.setdefault(process, []).append((at_s, memory_mb(pid)["resident"]))

    def change(self, process: str) -> float:
        """Relative change of a process's least memory,
        from the first half after the warm-up to the second.

        A session's map comes and goes; a leak would add to the memory that remains without it.
        """
        warm_up_s = min(WARM_UP_S, self.took_s / 4)
        middle_s = (warm_up_s + self.took_s) / 2
        sizes = self.resident_mb[process]
        first = min(mb for at_s, mb in sizes if warm_up_s < at_s <= middle_s)
        return min(mb for at_s, mb in sizes if at_s > middle_s) / first - 1

    def judge(self) -> None:
        """Check the last health messages and the memory."""
        for name in FINGERS:
            health = self.health.get(
                name, {"frames": {"pending": 1, "captured": 0}, "uptime_s": 0, "source_dropped": 0}
            )
            frames, due = health["frames"], health["uptime_s"] * FPS
            if (
                frames["pending"]
                or abs(frames["captured"] + health["source_dropped"] - due) > 3 * FPS
            ):
                self.problems.append(
                    f"{name}: {frames}, {health['source_dropped']} dropped, {due:.0f} were due"
                )
        for process in self.resident_mb:
            if abs(self.change(process)) > FLAT:
                self.problems.append(f"{process}: memory changed by {self.change(process):+.1%}")

    def table(self) -> str:
        """Write a table of what was done and what resulted."""
        rows = ["| what | |", "|---|---:|", f"| seconds | {self.took_s:.0f} |"]
        rows += [f"| {what} | {count} |" for what, count in sorted(self.counts.items()) if count]
        outcomes = Counter[str]()
        for health in self.health.values():
            outcomes += Counter(health["frames"]) + Counter(
                {"dropped by the source, and counted": health["source_dropped"]}
            )
        rows += [
            f"| frames of all fingers: {outcome} | {count} |" for outcome, count in outcomes.items()
        ]
        for number, (process, sizes) in enumerate(self.resident_mb.items()):
            name = re.sub(r" \d+$", f" {number}", process)
            most = max(mb for _, mb in sizes)
            rows.append(
                f"| {name}: most MB, change of the least | {most:.0f}, "
                f"{self.change(process):+.1%} |"
            )
        return "\n".join(
            (*rows, f"| not accounted for, out of order, ended, grown | {len(self.problems)} |")
        )


def settings(folder: Path, port: int, link: Path) -> Path:
    """Write the hand's calibrations and settings; return the settings' path."""
    lines = ["hand_id: soaked", "profile: fast", f"mqtt: {{host: 127.0.0.1, port: {port}}}"]
    lines += ["recorder: {folder: recs}", "stitching: {folder: maps}", "sensors:"]
    for k, name in enumerate(FINGERS):
        calibration_file.save(folder / f"{name}.npz", make_calibration())
        robot = (
            f", serial: {{device: /dev/..{link}}}" if k == 0 else ""
        )  # the settings require a path below /dev
        own = f"calibration: {name}.npz, source: {{kind: simulated}}{robot}"
        lines.append(f"  {name}: {{{own}, hand_T_sensor: [{40 * k}, 0, 90, 1, 0, 0, 0]}}")
    path = folder / "hand.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def run(seconds: float) -> tuple[str, list[str]]:
    """Run the hand for `seconds`; return a table and the problems."""
    with TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        draw_rings(folder)
        broker = stack.enter_context(Broker(folder))
        robot = stack.enter_context(
            PtyRobot(folder / "line", rate_hz=100, binary=True, where=place)
        )
        seen = stack.enter_context(Subscriber(broker.port, "tacshade/#"))
        rings = [
            folder / f"{'contact' if k < PRESSED else 'free'}.npy" for k in range(len(FINGERS))
        ]
        words = list(map(str, (settings(folder, broker.port, folder / "line"), FPS, *rings)))
        with (folder / "log").open("w") as log:
            hand = subprocess.Popen(
                [sys.executable, "-m", "tacshade_edge.lab.trial.ring_daemon", *words], stderr=log
            )
        stack.callback(hand.kill)
        bridges = {
            kind: stack.enter_context(BridgeProcess(kind, broker.port, folder / f"{kind}.log"))
            for kind in ("prometheus", "foxglove")
        }
        soak = Soak(folder, broker, seen, hand)
        viewers = [
            threading.Thread(target=soak.view, args=(bridges["foxglove"].url, reads))
            for reads in (True, False)
        ]
        for viewer in viewers:
            viewer.start()
        try:
            soak.run(seconds, bridges)
        finally:
            soak.over.set()
            for viewer in viewers:
                viewer.join()
        if (up := soak.scrape(bridges["prometheus"])) != set(FINGERS):
            soak.problems.append(f"prometheus at the end: up are {sorted(up)}")
        hand.terminate()
        code = hand.wait(30)
        threading.Event().wait(2.0)
        soak.hear()
        for kind, bridge in bridges.items():
            soak.counts[f"ms until {kind} ended"] = round(1000 * bridge.stopped_s())
        logs = {file.name: file.read_text() for file in (folder / "log", *folder.glob("*.log"))}
        soak.problems += [
            f"{file}: {text[-1000:]}" for file, text in logs.items() if "Traceback" in text
        ]
        if code:
            soak.problems.append(f"exit code {code}: {logs['log'][-1000:]}")
        serial = soak.health.get(FINGERS[0], {}).get("serial", {"poses": 0, "poses_lost": 1 << 60})
        if serial["poses"] + serial["poses_lost"] > robot.counts.poses:
            soak.problems.append(
                f"{serial['poses']} poses and {serial['poses_lost']} lost of {robot.counts.poses}"
            )
        soak.counts["lines of the hand's log"] = len(logs["log"].splitlines())
        soak.judge()
        return soak.table(), soak.problems
