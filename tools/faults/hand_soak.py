"""A long run of a whole hand: five fingers, both bridges, recordings in turn, and brokers that restart.

Each finger is a separate process, which reads a ring of images drawn in advance. A scraper reads Prometheus' page. One
viewer reads everything that Foxglove's bridge offers; another reads nothing, disconnects without notice and reconnects.
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
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.tables.frame_table import read_table
from tools.testbed.bridge_process import BridgeProcess
from tools.testbed.daemon_rig import draw_rings, memory_mb
from tools.testbed.mqtt_rig import Broker, Subscriber

FINGERS = tuple(f"finger{k}" for k in range(5))
PRESSED = 2
HAND_ID = "soaked"
FPS = 10.0
RESTART_S, AWAY_S = 60.0, 2.0
RECORD_S = 15.0
SCRAPE_S = 5.0
STALL_S = 20.0
WARM_UP_S = 900.0
"""Time until allocators have taken the memory that they keep; at most a quarter of the run."""
FLAT = 0.02
SUBPROTOCOL = ["foxglove.sdk.v1"]


@dataclass(slots=True)
class Soaked:
    """The results of the run; `resident_mb` lists (time in s, memory in MB) for each process."""

    counts: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    resident_mb: dict[str, list[tuple[float, float]]] = field(default_factory=dict)
    health: dict[str, dict[str, Any]] = field(default_factory=dict)
    took_s: float = 0.0

    def change(self, name: str) -> float:
        """Relative change of a process's least memory, from the first half after the warm-up to the second."""
        warm_up_s = min(WARM_UP_S, self.took_s / 4)
        middle_s = (warm_up_s + self.took_s) / 2
        told = self.resident_mb[name]
        first = min(mb for at_s, mb in told if warm_up_s < at_s <= middle_s)
        return min(mb for at_s, mb in told if at_s > middle_s) / first - 1


def settings(folder: Path, port: int) -> Path:
    """Write the hand's calibrations and settings; return the settings' path."""
    lines = [f"hand_id: {HAND_ID}", "profile: fast", f"mqtt: {{host: 127.0.0.1, port: {port}}}"]
    lines += ["recorder: {folder: recs}", "sensors:"]
    for k, name in enumerate(FINGERS):
        calibration_file.save(folder / f"{name}.npz", make_calibration())
        own = f"calibration: {name}.npz, source: {{kind: simulated}}"
        lines.append(f"  {name}: {{{own}, hand_T_sensor: [{40 * k}, 0, 90, 1, 0, 0, 0]}}")
    path = folder / "hand.yaml"
    path.write_text("\n".join(lines) + "\n")
    return path


def hear(out: Soaked, seen: Subscriber, last_seq: dict[str, int]) -> None:
    """Check and count the messages received since the last call."""
    messages, seen.messages[:] = list(seen.messages), []
    for message in messages:
        _, name, topic = message.topic.split("/", 2)
        if name == "hand":
            out.counts["messages of the hand"] += topic.endswith("objects")
        elif topic == "height":
            (seq,) = struct.unpack_from("<I", message.payload, 8)
            if seq <= last_seq.get(name, -1):
                out.problems.append(f"{name}: frame {seq} after {last_seq[name]}")
            last_seq[name] = seq
            out.counts["height maps received"] += 1
        elif topic == "health":
            health = json.loads(message.payload)
            frames, out.health[name] = health["frames"], health
            out.counts["health messages"] += 1
            if frames["captured"] != sum(count for outcome, count in frames.items() if outcome != "captured"):
                out.problems.append(f"{name}: not accounted for: {frames}")
        elif topic == "status/recorder":
            take_recording(out, json.loads(message.payload))


def take_recording(out: Soaked, status: dict[str, Any]) -> None:
    """Read a finished recording and delete it."""
    folder = Path(status.get("folder") or "/nowhere")
    if status["state"] == "recording" or not folder.is_dir():
        return
    rows = read_table(folder / "frames.csv")
    pictures = sum(1 for _ in folder.glob("*.png"))
    if not len(rows) == pictures == status["frames"]:
        out.problems.append(f"{folder.name}: {len(rows)} rows, {pictures} images, {status['frames']} reported")
    out.counts["recordings"] += 1
    out.counts["frames recorded"] += len(rows)
    out.counts["frames not recorded, and counted"] += status["dropped"]
    shutil.rmtree(folder)


def view(url: str, over: threading.Event, out: Soaked, *, reads: bool) -> None:
    """Subscribe to everything that the bridge offers, and read it only if `reads`."""
    who = "viewer" if reads else "viewer that reads nothing"
    while not over.is_set():
        with contextlib.suppress(OSError, WebSocketException), contextlib.ExitStack() as opened:
            viewer = opened.enter_context(
                connect(url, subprotocols=SUBPROTOCOL, max_size=None, compression=None, max_queue=1)  # type: ignore[arg-type]
            )
            out.counts[f"{who}: connections"] += 1
            until_s = time.monotonic() + STALL_S
            while not over.is_set() and (reads or time.monotonic() < until_s):
                try:
                    told = viewer.recv(timeout=1.0)
                except TimeoutError:
                    continue
                if isinstance(told, bytes):
                    out.counts[f"{who}: messages"] += 1
                    if not reads:
                        over.wait(STALL_S)
                        viewer.socket.close()
                        break
                    continue
                channels = json.loads(told).get("channels", ())
                wanted = [{"id": one["id"], "channelId": one["id"]} for one in channels]
                if wanted:
                    viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        over.wait(1.0)


@contextlib.contextmanager
def viewers(url: str, out: Soaked) -> Iterator[None]:
    """Run a viewer that reads and one that reads nothing."""
    over = threading.Event()
    threads = [threading.Thread(target=view, args=(url, over, out), kwargs={"reads": reads}) for reads in (True, False)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        over.set()
        for thread in threads:
            thread.join()


def family(pid: int) -> list[int]:
    """List a process and its children in the order in which they started."""
    found = subprocess.run(("pgrep", "-P", str(pid)), capture_output=True, check=False).stdout
    return [pid, *sorted(map(int, found.split()))]


def scrape(out: Soaked, bridge: BridgeProcess) -> set[str]:
    """Read Prometheus' page; return the fingers that it reports as up."""
    page = bridge.page()
    out.counts["pages of metrics"] += 1
    return set(re.findall(r'tacshade_up\{sensor="(\w+)"\} 1\.0', page))


def run(seconds: float, *, progress: bool = False) -> Soaked:
    """Run the hand for `seconds`."""
    out = Soaked()
    with TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        draw_rings(folder)
        broker = stack.enter_context(Broker(folder))
        config = settings(folder, broker.port)
        rings = [folder / f"{'contact' if k < PRESSED else 'free'}.npy" for k in range(len(FINGERS))]
        log = stack.enter_context((folder / "log").open("w"))
        seen = stack.enter_context(Subscriber(broker.port, "tacshade/#"))
        program = (sys.executable, "-m", "tools.testbed.ring_hand")
        hand = subprocess.Popen([*program, config, str(FPS), *rings], stderr=log)
        stack.callback(hand.kill)
        prometheus = stack.enter_context(BridgeProcess("prometheus", broker.port, folder / "prometheus.log"))
        foxglove = stack.enter_context(BridgeProcess("foxglove", broker.port, folder / "foxglove.log"))
        with viewers(foxglove.url, out):
            _play(out, seconds, hand, broker, seen, {"prometheus": prometheus, "foxglove": foxglove}, progress)
        up = scrape(out, prometheus)
        if up != set(FINGERS):
            out.problems.append(f"prometheus at the end: up are {sorted(up)}")
        hand.terminate()
        code = hand.wait(30)
        threading.Event().wait(2.0)
        hear(out, seen, {})
        for bridge, told in ((prometheus, "prometheus"), (foxglove, "foxglove")):
            out.counts[f"ms until {told} ended"] = round(1000 * bridge.stopped_s())
            if "Traceback" in bridge.log():
                out.problems.append(f"{told}: {bridge.log()[-1000:]}")
        text = (folder / "log").read_text()
        if code or "Traceback" in text:
            out.problems.append(f"exit code {code}: {text[-1000:]}")
        out.counts["lines of the hand's log"] = len(text.splitlines())
    _judge(out)
    return out


def _play(
    out: Soaked,
    seconds: float,
    hand: subprocess.Popen[bytes],
    broker: Broker,
    seen: Subscriber,
    bridges: dict[str, BridgeProcess],
    progress: bool,
) -> None:
    """Restart brokers, record fingers in turn, scrape, and measure memory until the time is over."""
    began_s, last_seq = time.monotonic(), dict[str, int]()
    next_s = {"restart": RESTART_S, "memory": 10.0, "progress": 60.0, "record": 5.0, "scrape": 10.0}
    down_since_s: float | None = None
    turn = 0
    pids: list[int] = []
    while (at_s := time.monotonic() - began_s) < seconds:
        if hand.poll() is not None:
            out.problems.append(f"the hand ended after {at_s:.0f} s")
            break
        hear(out, seen, last_seq)
        due = {what for what, due_s in next_s.items() if at_s >= due_s}
        if "memory" in due:
            next_s["memory"] = at_s + 5.0
            found = family(hand.pid)
            if pids and found != pids:
                out.problems.append(f"processes {found} after {pids}")
            pids = found
            named = {f"hand, process {number}": pid for number, pid in enumerate(pids)}
            for process, pid in (named | {told: bridge.process.pid for told, bridge in bridges.items()}).items():
                out.resident_mb.setdefault(process, []).append((at_s, memory_mb(pid)["resident"]))
        if "restart" in due and down_since_s is None:
            next_s["restart"] = at_s + RESTART_S
            broker.stop()
            down_since_s = at_s
            out.counts["restarts of the broker"] += 1
        if down_since_s is not None and at_s > down_since_s + AWAY_S:
            broker.start()
            down_since_s = None
        if "record" in due and down_since_s is None:
            next_s["record"] = at_s + RECORD_S + 2.0
            body = json.dumps({"action": "start", "seconds": RECORD_S}).encode()
            seen.publish(f"tacshade/{FINGERS[turn % len(FINGERS)]}/req/record", body, 0)
            turn += 1
        if "scrape" in due:
            next_s["scrape"] = at_s + SCRAPE_S
            scrape(out, bridges["prometheus"])
        if progress and "progress" in due:
            next_s["progress"] = at_s + 60.0
            megabytes = [f"{told[-1][1]:.0f}" for told in out.resident_mb.values()]
            print(f"{at_s:6.0f} s {' '.join(megabytes)} MB {dict(out.counts)}", file=sys.stderr, flush=True)
            print("\n".join(out.problems), file=sys.stderr, flush=True)
        threading.Event().wait(0.05)
    if down_since_s is not None:
        broker.start()
    threading.Event().wait(15.0)  # so that all clients reconnect
    out.took_s = time.monotonic() - began_s


def _judge(out: Soaked) -> None:
    for name in FINGERS:
        health = out.health.get(name)
        if health is None:
            out.problems.append(f"{name}: said nothing")
            continue
        frames = health["frames"]
        if frames["pending"]:
            out.problems.append(f"{name}: {frames['pending']} frames pending after the stop")
        due = health["uptime_s"] * FPS
        if abs(frames["captured"] + health["source_dropped"] - due) > 3 * FPS:
            out.problems.append(
                f"{name}: {frames['captured']} captured, {health['source_dropped']} dropped, {due:.0f} were due"
            )
    for name in out.resident_mb:
        if abs(out.change(name)) > FLAT:
            out.problems.append(f"{name}: memory changed by {out.change(name):+.1%}, expected within {FLAT:.0%}")


def table(out: Soaked) -> str:
    """Write a table of what was done and what resulted."""
    rows = ["| what | |", "|---|---:|", f"| seconds | {out.took_s:.0f} |"]
    rows += [f"| {what} | {count} |" for what, count in sorted(out.counts.items()) if count]
    outcomes = Counter[str]()
    for health in out.health.values():
        outcomes.update(health["frames"])
        outcomes["dropped before they were read, and counted"] += health["source_dropped"]
    rows += [f"| frames of all fingers: {outcome} | {count} |" for outcome, count in outcomes.items()]
    for name, told in out.resident_mb.items():
        most = max(mb for _, mb in told)
        rows.append(f"| {name}: most MB, change of the least | {most:.0f}, {out.change(name):+.1%} |")
    rows += [f"| not accounted for, out of order, ended, grown | {len(out.problems)} |"]
    return "\n".join(rows)
