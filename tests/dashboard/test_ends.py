"""SIGTERM and SIGKILL of the daemon and of the dashboard, each a process of its own, while a page
is open and a recording is being downloaded: what was stopped ends, the other goes on, nothing stays
behind, and what starts again serves the same page and the rest of the download.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from support.mqtt_rig import Broker, Subscriber, free_port
from support.painted_sensor import painted_calibration, write_posed_images
from support.patience import patience, wait_until
from support.recordings import recorded
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.dashboard.recording_tar import tar_of

pytestmark = [pytest.mark.broker, pytest.mark.slow]
BASE, MARK = "tacshade/finger", "TACSHADE_TEST_ENDS"
LARGE_BYTES, BEGUN_BYTES = 48 << 20, 1 << 20
UNFINISHED = (".part", ".new", ".tmp")
NUMBERS = (signal.SIGTERM, signal.SIGKILL)


class Machine:
    """A daemon and a dashboard on one broker, with a page that is open."""

    def __init__(self, folder: Path, broker: Broker) -> None:
        self.folder, self.broker, self.port = folder, broker, free_port()
        self.run = recorded(folder / "recs", "run")
        with (self.run / "large.bin").open("wb") as stream:
            stream.truncate(LARGE_BYTES)
        write_posed_images(folder / "images")
        calibration_file.save(folder / "c.npz", painted_calibration())
        self._settings = folder / "s.yaml"
        self._settings.write_text(
            "sensor_id: finger\nprofile: fast\ncalibration: c.npz\n"
            "source: {kind: files, path: images, fps: 60, loop: true}\n"
            f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\nrecorder: {{folder: recs}}\n"
        )
        self.daemon, self.dashboard = self.start_daemon(), self.start_dashboard()
        self.page = Subscriber(self.port, f"{BASE}/#", page=True)

    def __enter__(self) -> Machine:
        self.until_served()
        self.page.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.page.__exit__(None, None, None)
        for process in (self.daemon, self.dashboard):
            process.kill()
            process.wait()

    def _started(self, *words: str) -> subprocess.Popen[bytes]:
        with (self.folder / "log").open("a") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "tacshade_edge", *words],
                stdout=log,
                stderr=log,
                env={**os.environ, MARK: str(self.folder)},
            )

    def start_daemon(self) -> subprocess.Popen[bytes]:
        return self._started("run", "--config", str(self._settings))

    def start_dashboard(self) -> subprocess.Popen[bytes]:
        where = ("--broker", f"127.0.0.1:{self.broker.port}", "--http", str(self.port))
        return self._started("dashboard", *where, "--recordings", str(self.folder / "recs"))

    def until_served(self) -> None:
        def answers() -> bool:
            with socket.socket() as probe:
                return probe.connect_ex(("127.0.0.1", self.port)) == 0

        wait_until(answers, 30, "the dashboard listens")

    def until_fresh(self) -> None:
        """Wait until the page gets frames of now."""
        self.page.messages.clear()
        wait_until(lambda: len(self.page.of(f"{BASE}/height")) > 5, 30, "frames on the page")

    def until_state(self, state: str) -> None:
        said = lambda: self.page.of(f"{BASE}/state")[-1:] == [state.encode()]  # noqa: E731
        wait_until(said, 30, f"state {state}")

    @contextmanager
    def download(self, *headers: str) -> Iterator[socket.socket]:
        with socket.create_connection(("127.0.0.1", self.port), patience(30)) as client:
            lines = [f"GET /recordings/run.tar HTTP/1.1\r\nHost: 127.0.0.1:{self.port}", *headers]
            client.sendall("\r\n".join([*lines, "", ""]).encode())
            yield client

    def running(self) -> list[int]:
        """The processes that were started here, and their children."""
        found = []
        for path in Path("/proc").glob("[0-9]*/environ"):
            try:
                ours = f"{MARK}={self.folder}\0".encode() in path.read_bytes()
            except OSError:
                continue
            found += [int(path.parent.name)] if ours else []
        return found


def head_and(client: socket.socket, count: int) -> tuple[str, bytes]:
    """The head of an answer, and so many bytes of its body or more."""
    got = b""
    while b"\r\n\r\n" not in got or len(got.partition(b"\r\n\r\n")[2]) < count:
        some = client.recv(1 << 16)
        assert some, got[:300]
        got += some
    head, _, body = got.partition(b"\r\n\r\n")
    return head.decode().lower(), body


def rest_of(client: socket.socket) -> bytes:
    """What is still to come, until the connection ends, in whichever way."""
    got = []
    try:
        while some := client.recv(1 << 16):
            got.append(some)
    except ConnectionError:
        pass
    return b"".join(got)


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[Machine]:
    with Broker(tmp_path) as broker, Machine(tmp_path, broker) as made:
        made.until_fresh()
        yield made


@pytest.mark.parametrize("number", NUMBERS)
def test_of_the_daemon(
    number: signal.Signals, machine: Machine, record_property: Callable[[str, object], None]
) -> None:
    record_property("tried", 2)
    whole = b"".join(tar_of(machine.run).pieces(0, tar_of(machine.run).size_bytes))
    with machine.download() as client:
        _, begun = head_and(client, BEGUN_BYTES)
        machine.daemon.send_signal(number)
        assert machine.daemon.wait(patience(30)) == (0 if number == signal.SIGTERM else -number)
        machine.until_state("stopped" if number == signal.SIGTERM else "offline")
        assert machine.running() == [machine.dashboard.pid]
        assert begun + rest_of(client) == whole
    assert not [path for path in machine.folder.rglob("*") if path.name.endswith(UNFINISHED)]
    machine.daemon = machine.start_daemon()
    machine.until_state("online")
    machine.until_fresh()


@pytest.mark.parametrize("number", NUMBERS)
def test_of_the_dashboard(
    number: signal.Signals, machine: Machine, record_property: Callable[[str, object], None]
) -> None:
    record_property("tried", 2)
    descriptors = Path(f"/proc/{machine.broker.pid}/fd")
    before = len(list(descriptors.iterdir()))
    tar = tar_of(machine.run)
    whole = b"".join(tar.pieces(0, tar.size_bytes))
    files = sorted(machine.folder.rglob("*"))
    with Subscriber(machine.broker.port, f"{BASE}/state") as seen, machine.download() as client:
        head, begun = head_and(client, BEGUN_BYTES)
        machine.dashboard.send_signal(number)
        ended = machine.dashboard.wait(patience(30))
        assert ended == (0 if number == signal.SIGTERM else -number)
        begun += rest_of(client)
        assert len(begun) < len(whole)
        assert whole.startswith(begun)
        assert machine.running() == [machine.daemon.pid]
        assert sorted(machine.folder.rglob("*")) == files
        machine.dashboard = machine.start_dashboard()
        machine.until_served()
        machine.until_fresh()
        tag = next(line.split(": ")[1] for line in head.split("\r\n") if line.startswith("etag"))
        with machine.download(f"Range: bytes={len(begun)}-", f"If-Range: {tag}") as again:
            head, more = head_and(again, 1)
            assert head.startswith("http/1.1 206 ")
            assert begun + more + rest_of(again) == whole
        assert seen.of(f"{BASE}/state") == [b"online"]
    wait_until(lambda: len(list(descriptors.iterdir())) <= before, 30, "one page at the broker")
    assert "Traceback" not in (machine.folder / "log").read_text()
