"""The target of the faults: a daemon process with cheap frames, its broker,
its log and its messages.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from support.mqtt_rig import Broker, Subscriber
from support.painted_sensor import painted_calibration, write_posed_images
from support.patience import patience, wait_until
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.errors import DecodeError
from tacshade_edge.recording.recording import Recording

SENSOR_ID = "finger"
BASE = f"tacshade/{SENSOR_ID}"


@dataclass(frozen=True, slots=True)
class Seen:
    """What a fault cost, and where the daemon reported it.

    `detected_s` is the time until it was reported (None: there is nothing to report), `recovered_s`
    from the fault's end until the daemon worked again (None: nothing stops working).
    """

    lost: str
    where: str
    detected_s: float | None = None
    recovered_s: float | None = None


class SkippedError(Exception):
    """The fault cannot be produced here; the message says why."""


Fault = Callable[["Cell"], Seen]
FAULTS: dict[str, Fault] = {}
"""Every fault by its name in the table."""


def fault(name: str) -> Callable[[Fault], Fault]:
    """Enter a function in the table."""

    def entered(function: Fault) -> Fault:
        FAULTS[name] = function
        return function

    return entered


class Cell:
    """One daemon and its surroundings; every path is below its folder."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.broker = Broker(folder)
        self.seen = Subscriber(self.broker.port, f"{BASE}/#")
        self._daemon: subprocess.Popen[bytes] | None = None
        self._closing = contextlib.ExitStack()
        self._mark = 0
        write_posed_images(folder / "images")
        calibration_file.save(folder / "c.npz", painted_calibration())

    def __enter__(self) -> Cell:
        return self

    def __exit__(self, *_: object) -> None:
        if self._daemon is not None:
            self.kill()
        self._closing.close()
        self.broker.stop()

    @property
    def daemon(self) -> subprocess.Popen[bytes]:
        """The running daemon."""
        assert self._daemon is not None
        return self._daemon

    def enter(self, manager: Any) -> Any:
        """Enter a context manager that exits with the cell."""
        return self._closing.enter_context(manager)

    def serve(self, **options: Any) -> None:
        """Start the broker, with options for `Broker`, and subscribe to the daemon's messages."""
        if options:
            self.broker = Broker(self.folder, **options)
            self.seen = Subscriber(self.broker.port, f"{BASE}/#")
        self.broker.start()
        self.enter(self.seen)

    def settings(self, more: str = "", *, profile: str = "fast") -> Path:
        """Write the settings; return their path."""
        path = self.folder / "s.yaml"
        fresh = path.with_suffix(".new")
        fresh.write_text(
            f"sensor_id: {SENSOR_ID}\nprofile: {profile}\ncalibration: c.npz\n"
            "source: {kind: files, path: images, fps: 60, loop: true}\n"
            f"mqtt: {{host: 127.0.0.1, port: {self.broker.port}}}\n"
            f"recorder: {{folder: recs}}\nstitching: {{folder: maps}}\n{more}"
        )
        return fresh.replace(path)

    def start(
        self,
        path: Path | None = None,
        *,
        streams: bool = True,
        environment: dict[str, str] | None = None,
    ) -> float:
        """Start the daemon, if `streams` also the broker, and wait for frames;
        return the start's time in s.
        """
        if streams and not self.seen.client.is_connected():
            self.serve()
        self._mark, began_s = len(self.log()), time.monotonic()
        self._daemon = self.spawn(path or self.settings(), environment=environment)
        if streams:
            self.until(lambda: "source streaming" in self.new_log(), 30, "frames")
            self.until(
                lambda: self.last("health").get("frames", {}).get("captured", 0) > 5, 30, "health"
            )
        return began_s

    def spawn(
        self,
        path: Path,
        log: str = "log",
        environment: dict[str, str] | None = None,
    ) -> subprocess.Popen[bytes]:
        """Start a daemon; `environment` is added to this process's environment."""
        words = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(path)]
        with (self.folder / log).open("a") as stream:
            return subprocess.Popen(words, stderr=stream, env=os.environ | (environment or {}))

    @contextlib.contextmanager
    def second(self, line: str) -> Iterator[float]:
        """Run another daemon on the same settings until its log contains `line`;
        yield the seconds that this took.
        """
        began_s = time.monotonic()
        other = self.spawn(self.folder / "s.yaml", "other")
        try:
            self.until(
                lambda: line in self.log("other"), 20, f"{line}: {self.log('other')[-300:]!r}"
            )
            yield time.monotonic() - began_s
        finally:
            other.kill()
            other.wait()

    def kill(self) -> None:
        """Kill the daemon with SIGKILL."""
        self.daemon.send_signal(signal.SIGCONT)
        self.daemon.kill()
        self.daemon.wait()
        self._daemon = None

    def log(self, name: str = "log") -> str:
        """Read a log; by default, the one that the cell's daemons share."""
        path = self.folder / name
        return path.read_text(errors="replace") if path.exists() else ""

    def new_log(self) -> str:
        """Read the log since `mark`."""
        return self.log()[self._mark :]

    def mark(self) -> float:
        """Skip the log and the messages so far; return the time in s."""
        self._mark = len(self.log())
        self.seen.messages.clear()
        return time.monotonic()

    def reported(self, pattern: str, since_s: float, seconds: float = 30) -> float:
        """Wait until a new line of the log matches; return the seconds since `since_s`."""
        self.until(
            lambda: re.search(pattern, self.new_log()),
            seconds,
            f"{pattern} in {self.new_log()[-300:]!r}",
        )
        return time.monotonic() - since_s

    def until(self, condition: Callable[[], object], seconds: float, what: str) -> float:
        """Poll until the condition holds, and return the seconds;
        fail immediately if the daemon has ended.
        """

        def holds() -> object:
            assert self._daemon is None or self._daemon.poll() is None, (
                f"the daemon ended: {self.log()[-500:]}"
            )
            return condition()

        began_s = time.monotonic()
        wait_until(holds, seconds, what)
        return time.monotonic() - began_s

    def last(self, topic: str) -> Any:
        """Decode a topic's latest JSON message; an empty object if there is none."""
        payloads = self.seen.of(f"{BASE}/{topic}")
        return json.loads(payloads[-1]) if payloads else {}

    def maps_again(self) -> float:
        """Wait for height maps of frames from now on; return the seconds."""
        now_ns = time.monotonic_ns()
        self.seen.messages.clear()

        def fresh() -> int:
            return sum(
                int.from_bytes(p[16:24], "little") > now_ns for p in self.seen.of(f"{BASE}/height")
            )

        return self.until(lambda: fresh() > 2, 20, "height maps")

    def frames(self) -> dict[str, int]:
        """Read the frame counts of the next health message, which must add up."""
        before = len(self.seen.of(f"{BASE}/health"))
        self.until(lambda: len(self.seen.of(f"{BASE}/health")) > before, 10, "health")
        frames: dict[str, int] = self.last("health")["frames"]
        assert frames["captured"] == sum(n for name, n in frames.items() if name != "captured"), (
            frames
        )
        return frames

    def ask(self, verb: str, **body: Any) -> dict[str, Any]:
        """Send a request; return its answer."""
        before = len(self.seen.of(f"{BASE}/res/{verb}"))
        self.seen.publish(f"{BASE}/req/{verb}", json.dumps(body).encode())
        self.until(
            lambda: len(self.seen.of(f"{BASE}/res/{verb}")) > before,
            20,
            f"an answer to {verb} {body}",
        )
        answer: dict[str, Any] = self.last(f"res/{verb}")
        return answer

    def presses(self, count: int) -> int:
        """Wait until a session has `count` presses of settled contacts;
        return how many were acknowledged.
        """
        self.until(
            lambda: self.last("status/stitching").get("presses", 0) >= count, 30, f"{count} presses"
        )
        found: int = self.last("status/stitching")["presses"]
        return found

    def session(self, name: str = "one", count: int = 3) -> int:
        """Begin a session and wait for at least `count` presses."""
        answer = self.ask("stitch", action="begin", name=name)
        assert answer["ok"], answer
        return self.presses(count)

    def record(self, name: str = "r", frames: int = 30, **more: str) -> None:
        """Start a recording and wait until it has some frames."""
        assert self.ask("record", action="start", seconds=600, name=name, **more)["ok"]
        self.until(
            lambda: self.last("status/recorder").get("frames", 0) > frames, 30, "a recording"
        )

    def ended(self, process: subprocess.Popen[bytes]) -> int:
        """Wait until a process ends without a traceback; return its exit code."""
        code = process.wait(patience(30))
        assert "Traceback" not in self.log(), self.log()[-300:]
        return code


def frames_of(path: Path) -> tuple[list[int], list[str]]:
    """Read a recording's time stamps in ns, and the reports of damage."""
    recording, stamps_ns = Recording(path), list[int]()
    damage: list[str] = []
    while True:
        try:
            if (recorded := recording.read()) is None:
                return stamps_ns, damage
            stamps_ns.append(recorded.frame.t_ns)
        except DecodeError as error:
            damage.append(str(error))


@contextlib.contextmanager
def small_disk(at: Path, megabytes: int) -> Iterator[Path]:
    """Mount a separate small file system, which only root can do."""
    if os.getuid() != 0 or shutil.which("mount") is None:
        raise SkippedError("needs root: a small file system")
    at.mkdir(parents=True, exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", f"size={megabytes}m", "tmpfs", str(at)]
    if subprocess.run(words, capture_output=True, check=False).returncode:
        raise SkippedError("a file system cannot be mounted here")
    try:
        yield at
    finally:
        subprocess.run(["umount", "-l", str(at)], check=False)


def pause(seconds: float) -> None:
    """Wait for as long as a fault lasts."""
    threading.Event().wait(seconds)
