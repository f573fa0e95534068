"""kill -9 at random moments: nothing acknowledged is lost, and every file has either its old or its new state.

One daemon after another works on the same files: it records, takes presses, renews its reference and reloads its
settings until it is killed. `tacshade-edge calibrate` is killed while it makes a new calibration.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2

from tacshade_edge.errors import TacshadeError
from tacshade_edge.settings import load
from tacshade_edge.storage.calibration import calibration_file, reference_file
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.stitching.stitch_file import StitchFile, read_info
from tools.faults.rig import write_posed_images
from tools.testbed.calibrated_sensor import HALF, references
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.painted_sensor import painted_calibration
from tools.testbed.patience import patience

SENSOR_ID = "finger"
BASE = f"tacshade/{SENSOR_ID}"
LONGEST_S = 3.0
"""Longest time from the first frame to the kill."""
STEP_S = 0.15
COMMAND = (sys.executable, "-m", "tacshade_edge")


@dataclass(slots=True)
class Acknowledged:
    """The work that the daemons have acknowledged."""

    presses: dict[str, int] = field(default_factory=dict)
    ended: dict[str, dict[str, Any]] = field(default_factory=dict)
    aborted: set[str] = field(default_factory=set)
    recorded: dict[str, int] = field(default_factory=dict)
    finished: dict[str, int] = field(default_factory=dict)
    reference_crc32: int | None = None
    reference_asked: bool = False
    """Whether a reference was requested after the last acknowledged one."""


@dataclass(slots=True)
class Kills:
    """Counts of the kills, and the problems."""

    doing: Counter[str] = field(default_factory=Counter)
    said: Counter[str] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    restart_s: list[float] = field(default_factory=list)


class Killed:
    """The files that all killed daemons share, and the work that they acknowledged; problems go to `kills`."""

    def __init__(self, folder: Path, broker: Broker, seen: Subscriber, kills: Kills) -> None:
        self.folder = folder
        self.known, self.kills = Acknowledged(), kills
        self._seen = seen
        self._told = 0
        self._settings = folder / "settings.yaml"
        self._texts = [
            f"sensor_id: {SENSOR_ID}\nprofile: {profile}\ncalibration: c.npz\n"
            "source: {kind: files, path: images, fps: 60, loop: true}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            "recorder: {folder: recs}\nstitching: {folder: maps}\n"
            for profile in ("fast", "balanced")
        ]
        self._settings.write_text(self._texts[0])
        self._names = 0
        write_posed_images(folder / "images")
        calibration_file.save(folder / "c.npz", painted_calibration())

    def one(self, draw: random.Random, longest_s: float) -> None:
        """Start a daemon, let it work for at most `longest_s`, kill it, and check its files."""
        self._seen.messages.clear()
        self._told = 0
        began_s = time.monotonic()
        log = self.folder / "log"
        with log.open("w") as stream:
            child = subprocess.Popen([*COMMAND, "run", "--config", str(self._settings)], stderr=stream)
        try:
            if not self._wait(lambda: self._latest("contact"), 30, child):
                self.kills.problems.append(f"did not start again: {log.read_text()[-500:]}")
                return
            self.kills.restart_s.append(time.monotonic() - began_s)
            self._started(log)
            kill_s = time.monotonic() + draw.uniform(0, longest_s)
            doing = "nothing yet"
            while time.monotonic() < kill_s:
                doing = self._ask(draw, child)
                threading.Event().wait(min(draw.uniform(0, STEP_S), max(0.0, kill_s - time.monotonic())))
            if child.poll() is not None:
                self.kills.problems.append(f"ended by itself: {log.read_text()[-500:]}")
            self.kills.doing[doing] += 1
        finally:
            child.kill()
            child.wait()
        threading.Event().wait(0.2)  # the broker still delivers the daemon's last messages
        self._hear()
        self._look()

    def _wait(self, condition: Any, seconds: float, child: subprocess.Popen[bytes]) -> bool:
        deadline_s = time.monotonic() + patience(seconds)
        while not condition():
            if child.poll() is not None or time.monotonic() > deadline_s:
                return False
            threading.Event().wait(0.01)
        return True

    def _latest(self, topic: str) -> Any:
        payloads = self._seen.of(f"{BASE}/{topic}")
        return json.loads(payloads[-1]) if payloads else None

    def _started(self, log: Path) -> None:
        """Check what the new daemon reports about itself."""
        info = self._latest("info")
        crc32, known = info["geometry"]["calibration_crc32"], self.known
        original = calibration_file.load(self.folder / "c.npz").crc32
        expected = {known.reference_crc32 or original}
        if known.reference_asked:
            stored = reference_file.load(
                reference_file.path_beside(self.folder / "c.npz"), calibration_file.load(self.folder / "c.npz")
            )
            expected.add(original if stored is None else stored.calibration.crc32)
        if crc32 not in expected:
            self.kills.problems.append(f"runs on the reference {crc32:08x}, expected one of {expected}")
        known.reference_crc32, known.reference_asked = (None if crc32 == original else crc32), False
        for line in log.read_text().splitlines():
            if "Traceback" in line:
                self.kills.problems.append(f"a traceback at the start: {log.read_text()[-500:]}")

    def _ask(self, draw: random.Random, child: subprocess.Popen[bytes]) -> str:
        """Send one more request; return its name."""
        self._hear()
        what = draw.choice(("press", "press", "press", "end", "abort", "record", "record", "reference", "reload"))
        self._names += 1
        name = f"n{self._names}"
        if what == "press":
            self._publish("stitch", {"action": "begin", "name": name})
            self._publish("stitch", {"action": "add"})
        elif what in ("end", "abort"):
            if draw.random() < 0.5:
                self._publish("stitch", {"action": what})
        elif what == "record":
            action = {"action": "start", "seconds": 60, "name": name} if draw.random() < 0.6 else {"action": "stop"}
            self._publish("record", action)
        elif what == "reference":
            self.known.reference_asked = True
            self._publish("reference", {})
        else:
            fresh = self._settings.with_suffix(".new")
            fresh.write_text(draw.choice(self._texts))
            fresh.replace(self._settings)
            child.send_signal(signal.SIGHUP)
        return what

    def _publish(self, verb: str, body: dict[str, Any]) -> None:
        body["transaction"] = f"{verb} {body.get('action', '')}"
        self._seen.publish(f"{BASE}/req/{verb}", json.dumps(body).encode())

    def _hear(self) -> None:
        """Take the acknowledgements since the last call."""
        known, messages = self.known, list(self._seen.messages)
        for message in messages[self._told :]:
            part = message.topic.removeprefix(f"{BASE}/")
            if part not in ("status/stitching", "status/recorder", "res/stitch", "res/record", "res/reference"):
                continue
            said = json.loads(message.payload)
            if part == "status/stitching" and said["name"]:
                known.presses[said["name"]] = max(known.presses.get(said["name"], 0), said["presses"])
            elif part == "status/recorder" and said["state"] == "recording":
                known.recorded[said["folder"]] = max(known.recorded.get(said["folder"], 0), said["frames"])
            elif part.startswith("res/") and said["ok"]:
                self._acknowledge(said["transaction"], said["result"])
        self._told = len(messages)

    def _acknowledge(self, what: str, result: dict[str, Any]) -> None:
        known = self.known
        self.kills.said[what.strip()] += 1
        if what == "stitch begin":
            known.presses[result["name"]] = 0
        elif what == "stitch end":
            known.ended[result["name"]] = result
        elif what == "stitch abort":
            known.aborted.add(result["name"])
        elif what == "stitch add":
            name = max(known.presses, key=lambda one: int(one[1:]))
            known.presses[name] = max(known.presses[name], result["press"])
        elif what == "record start":
            known.recorded.setdefault(result["folder"], 0)
        elif what == "record stop":
            known.finished[result["folder"]] = result["frames"]
        else:
            known.reference_crc32, known.reference_asked = result["calibration_crc32"], False

    def _look(self) -> None:
        """Check that everything acknowledged is on the disk."""
        for name, presses in list(self.known.presses.items()):
            self._look_at_session(name, presses)
        for folder, frames in list(self.known.recorded.items()):
            self._look_at_recording(Path(folder), frames)
        try:
            load(self._settings)
        except TacshadeError as error:
            self.kills.problems.append(f"settings: {error}")

    def _look_at_session(self, name: str, presses: int) -> None:
        folder, known = self.folder / "maps" / name, self.known
        over = name in known.aborted or name in known.ended
        if name in known.aborted:
            if (folder / "session.json").exists():
                self.kills.problems.append(f"session {name} was aborted and is there")
        elif not folder.exists():
            # The abort was done but not yet acknowledged, so this is the new state.
            over = True
            if name in known.ended:
                self.kills.problems.append(f"session {name} ended with {presses} presses and is gone")
        else:
            with TemporaryDirectory() as copied:
                shutil.copytree(folder, Path(copied, name))
                try:
                    info = read_info(Path(copied, name))
                    found = len(StitchFile.resume(Path(copied, name))[1])
                except TacshadeError as error:
                    self.kills.problems.append(f"session {name}: {error}")
                    return
            if found < presses:
                self.kills.problems.append(f"session {name}: {found} presses are there, {presses} were acknowledged")
            if name in known.ended and (info.state != "ended" or not (folder / "map.npz").exists()):
                self.kills.problems.append(f"session {name} was ended and is {info.state}")
            over = over or info.state == "ended"
        if over:
            del known.presses[name]

    def _look_at_recording(self, folder: Path, frames: int) -> None:
        read = 0
        try:
            recording = Recording(folder)
            while recording.read() is not None:
                read += 1
        except TacshadeError as error:
            if frames:
                self.kills.problems.append(f"recording {folder.name}: {error}")
        if read < frames:
            self.kills.problems.append(f"recording {folder.name}: {read} frames are there, {frames} were told")
        finished = self.known.finished.get(str(folder))
        if finished is not None and (read != finished or not (folder / "recording.json").exists()):
            self.kills.problems.append(f"recording {folder.name}: {read} frames, {finished} at its end")
        self.kills.said["frames read again"] += read
        del self.known.recorded[str(folder)]
        shutil.rmtree(folder)


def run_daemons(count: int, seed: int, kills: Kills, longest_s: float = LONGEST_S) -> None:
    """Kill `count` daemons, each at most `longest_s` after its first frame."""
    with TemporaryDirectory() as name, Broker(Path(name)) as broker, Subscriber(broker.port, f"{BASE}/#") as seen:
        folder = Path(name) / "daemon"
        folder.mkdir()
        killed = Killed(folder, broker, seen, kills)
        for number in range(count):
            before = len(kills.problems)
            killed.one(random.Random(f"{seed}:{number}"), longest_s)
            kills.problems[before:] = [f"kill {number}: {problem}" for problem in kills.problems[before:]]


def run_calibrations(count: int, seed: int, kills: Kills) -> None:
    """Kill `count` runs of `calibrate` over an existing calibration, from their start to just after their end."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        for k, image in enumerate(references(HALF, 4)):
            cv2.imwrite(str(folder / f"r{k}.png"), image)
        (folder / "SENSOR.yaml").write_text(
            f"skin_radius_mm: {HALF.skin_radius_mm}\ncamera_distance_mm: {HALF.camera_distance_mm}\n"
            f"visible_half_angle_deg: {HALF.visible_half_angle_deg}\npolarity: bright\n"
        )
        crc32s = set()
        took_s = []
        for images in (("r0.png", "r1.png"), ("r2.png", "r3.png")):
            began_s = time.monotonic()
            _calibrate(folder, images).communicate()
            took_s.append(time.monotonic() - began_s)
            crc32s.add(calibration_file.load(folder / "c.npz").crc32)
        for number in range(count):
            draw = random.Random(f"{seed}:calibrate:{number}")
            child = _calibrate(folder, draw.choice((("r0.png", "r1.png"), ("r2.png", "r3.png"))))
            # Half of the kills come near the end, when `calibrate` writes the file.
            longest_s = min(took_s)
            late = draw.random() < 0.5
            threading.Event().wait(draw.uniform(0.7 if late else 0.0, 1.1) * longest_s)
            kills.doing["calibrate" if child.poll() is None else "calibrate, just over"] += 1
            child.kill()
            child.communicate()
            try:
                found = calibration_file.load(folder / "c.npz").crc32
            except TacshadeError as error:
                kills.problems.append(f"calibrate {number}: {error}")
                continue
            if found not in crc32s:
                kills.problems.append(f"calibrate {number}: neither the old nor the new calibration")


def _calibrate(folder: Path, images: tuple[str, ...]) -> subprocess.Popen[bytes]:
    words = ("calibrate", "--sensor", "SENSOR.yaml", "--out", "c.npz", "--reference", *images)
    return subprocess.Popen(
        [*COMMAND, *words], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=os.environ
    )


def table(kills: Kills) -> str:
    """Write a table of the work at the moment of the kill and of the acknowledged work."""
    restarts = sorted(kills.restart_s) or [0.0]
    rows = ["| killed while the latest was | kills |", "|---|---:|"]
    rows += [f"| {what} | {count} |" for what, count in sorted(kills.doing.items())]
    rows += [f"| all | {kills.doing.total()} |", "", "| acknowledged, and looked for after the kill | count |"]
    rows += ["|---|---:|", *(f"| {what} | {count} |" for what, count in sorted(kills.said.items()))]
    rows += [f"| lost, or neither old nor new | {len(kills.problems)} |", ""]
    rows += [f"From a start to the first result {restarts[len(restarts) // 2]:.1f} s, at most {restarts[-1]:.1f} s."]
    return "\n".join(rows)
