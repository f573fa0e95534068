"""kill -9 at random moments: nothing acknowledged is lost,
and every file has either its old or its new state.

One daemon after another works on the same files: it records, takes presses, renews its reference
and reloads its settings until it is killed.
"""

from __future__ import annotations

import json
import random
import shutil
import signal
import time
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.errors import TacshadeError
from tacshade_edge.stitching.stitch_file import StitchFile, read_info
from tools.faults.rig import BASE, Cell, frames_of, pause

LONGEST_S = 3.0
"""Longest time from the first frame to the kill."""
STEP_S = 0.15
WORK = ("press", "press", "press", "end", "abort", "record", "record", "reference", "reload")


class Killed:
    """Daemons that share files, and the work that they acknowledged."""

    def __init__(self, cell: Cell) -> None:
        self._cell = cell
        self.doing, self.said = Counter[str](), Counter[str]()
        self.problems: list[str] = []
        self._names = self._heard = 0
        self._presses: dict[str, int] = {}
        self._over: dict[str, str] = {}
        """How each session was acknowledged to be over: `ended` or `aborted`."""
        self._frames: dict[Path, int] = {}
        self._finished: dict[Path, int] = {}
        self._original = calibration_file.load(cell.folder / "c.npz").crc32
        self._reference: int | None = self._original
        """None while a reference is requested and not acknowledged:
        then it may have been stored or not.
        """

    def one(self, draw: random.Random, longest_s: float) -> None:
        """Start a daemon, let it work for at most `longest_s`, kill it, and check its files."""
        cell = self._cell
        self.forget()
        cell.start(streams=False)
        cell.until(lambda: cell.last("contact"), 30, "the first frame")
        crc32 = cell.last("info")["geometry"]["calibration_crc32"]
        if self._reference not in (None, crc32):
            self.problems.append(
                f"runs on the reference {crc32:08x}, expected {self._reference:08x}"
            )
        self._reference, doing = crc32, "nothing yet"
        kill_s = time.monotonic() + draw.uniform(0, longest_s)
        while time.monotonic() < kill_s:
            doing = draw.choice(WORK)
            self._work(doing, draw)
            pause(min(draw.uniform(0, STEP_S), max(0.0, kill_s - time.monotonic())))
            self.hear()
        if cell.daemon.poll() is not None or "Traceback" in cell.new_log():
            self.problems.append(f"ended by itself: {cell.new_log()[-500:]}")
        self.doing[doing] += 1
        cell.kill()
        self.look()

    def forget(self) -> None:
        """Skip the log and the messages so far."""
        self._cell.mark()
        self._heard = 0

    def look(self) -> None:
        """Check the files of a daemon that has ended against what was acknowledged."""
        pause(0.2)  # the broker still delivers the daemon's last messages
        self.hear()
        for name, presses in list(self._presses.items()):
            self._look_at_session(name, presses)
        for folder, frames in self._frames.items():
            self._look_at_recording(folder, frames)
        self._frames.clear()

    def _work(self, what: str, draw: random.Random) -> None:
        self._names += 1
        if what == "press":
            self._ask("stitch", "begin", name=f"n{self._names}")
            self._ask("stitch", "add")
        elif what in ("end", "abort"):
            if draw.random() < 0.5:
                self._ask("stitch", what)
        elif what == "record":
            if draw.random() < 0.6:
                self._ask("record", "start", seconds=60, name=f"n{self._names}")
            else:
                self._ask("record", "stop")
        elif what == "reference":
            self._reference = None
            self._ask("reference")
        else:
            self._cell.settings(profile=draw.choice(("fast", "balanced")))
            self._cell.daemon.send_signal(signal.SIGHUP)

    def _ask(self, verb: str, action: str = "", **body: Any) -> None:
        asked = {
            "transaction": f"{verb} {action}".strip(),
            **({"action": action} if action else {}),
            **body,
        }
        self._cell.seen.publish(f"{BASE}/req/{verb}", json.dumps(asked).encode())

    def hear(self) -> None:
        """Take the acknowledgements since the last call."""
        messages = list(self._cell.seen.messages)
        for message in messages[self._heard :]:
            topic = message.topic.removeprefix(f"{BASE}/")
            if topic not in (
                "status/stitching",
                "status/recorder",
                "res/stitch",
                "res/record",
                "res/reference",
            ):
                continue
            said = json.loads(message.payload)
            if topic == "status/stitching" and said["name"]:
                self._presses[said["name"]] = max(
                    self._presses.get(said["name"], 0), said["presses"]
                )
            elif topic == "status/recorder" and said["state"] == "recording":
                folder = Path(said["folder"])
                self._frames[folder] = max(self._frames.get(folder, 0), said["frames"])
            elif topic.startswith("res/") and said["ok"]:
                self._acknowledged(said["transaction"], said["result"])
        self._heard = len(messages)

    def _acknowledged(self, what: str, result: dict[str, Any]) -> None:
        self.said[what] += 1
        if what == "stitch begin":
            self._presses[result["name"]] = 0
        elif what in ("stitch end", "stitch abort"):
            self._over[result["name"]] = "ended" if what == "stitch end" else "aborted"
        elif what == "stitch add":
            name = max(self._presses, key=lambda one: int(one[1:]))
            self._presses[name] = max(self._presses[name], result["press"])
        elif what == "record start":
            self._frames.setdefault(Path(result["folder"]), 0)
        elif what == "record stop":
            self._finished[Path(result["folder"])] = result["frames"]
        else:
            self._reference = result["calibration_crc32"]

    def _look_at_session(self, name: str, presses: int) -> None:
        folder, over = self._cell.folder / "maps" / name, self._over.get(name)
        state, found = "gone", 0
        if over == "aborted" or not folder.exists():
            state = "there" if (folder / "session.json").exists() else "gone"
        else:
            with TemporaryDirectory() as copied:
                shutil.copytree(folder, Path(copied, name))
                try:
                    state, found = (
                        read_info(Path(copied, name)).state,
                        len(StitchFile.resume(Path(copied, name))[1]),
                    )
                except TacshadeError as error:
                    state = str(error)
            if found < presses:
                self.problems.append(
                    f"session {name}: {found} presses are there, {presses} were acknowledged: "
                    f"{state}"
                )
        # An abort or end that was done but not yet acknowledged is the new state, too.
        right = {
            "aborted": state == "gone",
            "ended": state == "ended" and (folder / "map.npz").exists(),
        }
        if over and not right[over]:
            self.problems.append(f"session {name} was {over} and is {state}")
        if over or state in ("gone", "ended"):
            del self._presses[name]

    def _look_at_recording(self, folder: Path, frames: int) -> None:
        read = 0
        try:
            read = len(frames_of(folder)[0])
        except TacshadeError as error:
            if frames:
                self.problems.append(f"recording {folder.name}: {error}")
        finished = self._finished.get(folder)
        if read < frames or (
            finished is not None and (read != finished or not (folder / "recording.json").exists())
        ):
            self.problems.append(
                f"recording {folder.name}: {read} frames are there, "
                f"{finished or frames} were reported"
            )
        self.said["frames read again"] += read
        shutil.rmtree(folder, ignore_errors=True)


def run(count: int, seed: int, longest_s: float = LONGEST_S) -> tuple[str, list[str]]:
    """Kill `count` daemons, each at most `longest_s` after its first frame;
    return a table and the problems.
    """
    with TemporaryDirectory() as name, Cell(Path(name) / "cell") as cell:
        cell.serve()
        killed = Killed(cell)
        for number in range(count):
            before = len(killed.problems)
            killed.one(random.Random(f"{seed}:{number}"), longest_s)
            killed.problems[before:] = [
                f"kill {number}: {problem}" for problem in killed.problems[before:]
            ]
    rows = ["| killed while the latest was | kills |", "|---|---:|"]
    rows += [f"| {what} | {times} |" for what, times in sorted(killed.doing.items())]
    rows += [
        f"| all | {killed.doing.total()} |",
        "",
        "| acknowledged, and looked for after the kill | count |",
    ]
    rows += [
        "|---|---:|",
        *(f"| {what} | {times} |" for what, times in sorted(killed.said.items())),
    ]
    rows += [f"| lost, or neither old nor new | {len(killed.problems)} |"]
    return "\n".join(rows), killed.problems
