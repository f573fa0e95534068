"""What a service manager hears: the real daemon in this process, a real datagram socket,
a scripted camera.
"""

from __future__ import annotations

import importlib.util
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from support.mqtt_rig import free_port
from support.painted_sensor import painted_calibration
from support.patience import patience, wait_until
from support.running_app import GONE, Running, paced
from tacshade_edge import libsystemd
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.daemon import app as app_module
from tacshade_edge.daemon import sensor_state, systemd
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.systemd import STOP_USEC, Service, notify
from tacshade_edge.errors import DecodeError
from tacshade_edge.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.pipeline.pipeline import Grab, Mailbox, Reconstruct
from tacshade_edge.settings import load
from tacshade_edge.types import Calibration, Frame, Need

pytestmark = pytest.mark.slow


class Manager:
    """The service manager's end of the socket; keeps every message."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self.heard: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        while message := self._socket.recv(65536).decode():
            self.heard.append(message)

    def has(self, text: str, since: int = 0) -> bool:
        return any(text in message for message in self.heard[since:])

    def watchdogs(self) -> int:
        return self.heard.count("WATCHDOG=1")

    def statuses(self) -> int:
        return sum(message.startswith("STATUS=") for message in self.heard)


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Manager:
    made = Manager(tmp_path / "notify")
    monkeypatch.setattr(app_module, "HEALTH_PERIOD_S", 0.1)
    monkeypatch.setattr(sensor_state, "STALL_S", 0.5)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    return made


@pytest.fixture
def settings(tmp_path: Path) -> Path:
    calibration_file.save(tmp_path / "c.npz", painted_calibration())
    path = tmp_path / "settings.yaml"
    broker = f"mqtt: {{host: 127.0.0.1, port: {free_port()}}}\n"
    path.write_text(f"calibration: c.npz\nprofile: fast\nsource: {{kind: simulated}}\n{broker}")
    return path


@pytest.fixture
def start(settings: Path, calibration: Calibration) -> Iterator[Callable[[Any], App]]:
    with ExitStack() as stack:
        yield lambda source: stack.enter_context(Running(load(settings), source, calibration)).app


def streaming(picture: Any, until: threading.Event | None = None) -> Iterator[Any]:
    while until is None or not until.is_set():
        yield from paced(picture, 1)


def test_ready_status_watchdog_stopping(
    manager: Manager, start: Any, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    app = start(scripted(streaming(pictures.touched)))
    wait_until(lambda: manager.watchdogs() >= 2)
    assert manager.heard[0] == "READY=1"
    wait_until(lambda: manager.has("STATUS=streaming, "))
    assert not manager.has("STOPPING=1")
    app.stop()
    wait_until(lambda: manager.has("STOPPING=1\n"))
    assert manager.heard[-1] == f"STOPPING=1\nEXTEND_TIMEOUT_USEC={STOP_USEC}\nSTATUS=stopping"


def test_a_hung_read_is_not_fed_although_the_main_thread_lives(
    manager: Manager, start: Any, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    hang, release = threading.Event(), threading.Event()
    start(scripted(hanging(pictures, hang, release)))
    wait_until(lambda: manager.watchdogs() >= 1)
    hang.set()
    wait_until(lambda: manager.has("STATUS=away (no frame for more than"))
    fed, statuses = manager.watchdogs(), manager.statuses()
    wait_until(lambda: manager.statuses() >= statuses + 2)
    assert manager.watchdogs() == fed
    release.set()
    wait_until(lambda: manager.watchdogs() > fed)


def hanging(pictures: Any, hang: threading.Event, release: threading.Event) -> Iterator[Any]:
    yield from streaming(pictures.free, hang)
    yield release.wait
    yield from streaming(pictures.free)


def test_a_bad_reload_keeps_what_runs(
    manager: Manager,
    start: Any,
    settings: Path,
    pictures: Any,
    scripted: Any,
    wait_until: Any,
    caplog: pytest.LogCaptureFixture,
) -> None:
    app = start(scripted(streaming(pictures.free)))
    wait_until(lambda: manager.watchdogs() >= 1)
    before, good = app.active.reconstructor, settings.read_text()
    settings.write_text(good.replace("c.npz", "absent.npz"))
    fed = manager.watchdogs()
    app.reload()
    wait_until(lambda: manager.has("READY=1\nSTATUS=rejected the reload"))
    warnings = [record.getMessage() for record in caplog.records if "reload" in record.getMessage()]
    assert len(warnings) == 1
    assert "absent.npz" in warnings[0]
    wait_until(lambda: manager.has("frames/s; rejected the reload"))
    wait_until(lambda: manager.watchdogs() > fed)
    assert app.active.reconstructor is before
    settings.write_text(good)
    app.reload()
    wait_until(lambda: manager.has("READY=1\nSTATUS=reloaded"))
    heard = len(manager.heard)
    wait_until(lambda: manager.has("STATUS=streaming", heard))
    assert not manager.has("rejected", heard)


def test_a_reload_takes_over_profile_and_calibration_but_a_new_source_or_broker_waits_for_a_restart(
    manager: Manager, start: Any, settings: Path, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    app = start(scripted(streaming(pictures.free)))
    wait_until(lambda: manager.watchdogs() >= 1)
    before, began_us = app.active.reconstructor, time.monotonic_ns() // 1000
    other = calibration_file.with_crc(
        replace(painted_calibration(), noise_grey=painted_calibration().noise_grey + 1.0)
    )
    calibration_file.save(settings.parent / "other.npz", other)
    text = settings.read_text()
    for old, new in (
        ("simulated", "simulated, fps: 7"),
        ("127.0.0.1", "localhost"),
        ("fast", "paper"),
        ("c.npz", "other.npz"),
    ):
        text = text.replace(old, new)
    settings.write_text(text)
    app.reload()
    wait_until(
        lambda: manager.has("READY=1\nSTATUS=restart the daemon to use the new source and mqtt")
    )
    assert app.active.reconstructor.profile.name == "paper"
    reloading = next(
        message for message in manager.heard if message.startswith("RELOADING=1\nMONOTONIC_USEC=")
    )
    assert began_us <= int(reloading.rpartition("=")[2]) <= time.monotonic_ns() // 1000
    assert app.active.reconstructor.calibration.crc32 == other.crc32 != before.calibration.crc32


class Steps(FrameObserver):
    """A reconstructor's and a sink's place, for a worker whose counters matter."""

    calibration = painted_calibration()

    def __init__(self) -> None:
        self.held, self.go = threading.Event(), threading.Event()
        self.ledger = FrameLedger()
        self.reconstructor = self
        self.calibration = None

    def step(self, _frame: Frame, _mark: Any, _need: Need) -> Any:
        self.held.set()
        assert self.go.wait(patience(10))

    def need(self) -> Need:
        return Need.DEPTH

    def see(self, seen: FrameResult) -> None:
        self.ledger.settle(seen.frame.seq, "without_contact")


AWAY, STREAMING = SourceState("away"), SourceState("streaming")


def feeds(manager: Manager, service: Service, state: SourceState) -> bool:
    """Whether the service feeds the watchdog in that state."""
    fed, heard = manager.watchdogs(), len(manager.heard)
    service.tick(state, 0.0)
    notify("STATUS=ticked")
    wait_until(lambda: manager.has("STATUS=ticked", heard), 10, "the end of the tick")
    return manager.watchdogs() > fed


def test_a_hung_step_is_no_progress_even_while_a_lost_camera_is_tried(
    manager: Manager, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    mailbox: Mailbox[Frame] = Mailbox()
    steps = Steps()
    worker = Reconstruct(lambda: steps, mailbox, Timings(), [steps])  # type: ignore[arg-type]
    source = scripted([pictures.free, GONE], GONE, [DecodeError("torn"), GONE], *[GONE] * 99)
    grab = Grab(source, mailbox, steps.ledger, lambda _state: None)
    service = Service(grab, worker)
    assert not feeds(manager, service, AWAY)
    threads = [threading.Thread(target=worker.run), threading.Thread(target=grab.run)]
    for thread in threads:
        thread.start()
    assert steps.held.wait(patience(10))
    wait_until(lambda: grab.attempts >= 4)  # three openings and the torn frame
    assert not feeds(manager, service, AWAY)
    steps.go.set()
    wait_until(lambda: worker.processed == 1)
    assert feeds(manager, service, STREAMING)
    before = grab.attempts
    wait_until(lambda: grab.attempts > before)
    assert not feeds(manager, service, STREAMING)
    before = grab.attempts
    wait_until(lambda: grab.attempts > before)
    assert feeds(manager, service, AWAY)
    grab.stop()
    mailbox.close()
    for thread in threads:
        thread.join(patience(10))


@pytest.fixture(params=["libsystemd", "a socket"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """With systemd-python, and without it."""
    with_library: bool = request.param == "libsystemd"
    # Run from the repository's root, its folder `systemd` looks like a package.
    found = importlib.util.find_spec("systemd") and importlib.util.find_spec("systemd.daemon")
    if with_library and found is None:
        pytest.skip("systemd-python is not installed")
    if not with_library:
        monkeypatch.setitem(sys.modules, "systemd.daemon", None)
    libsystemd.module.cache_clear()
    assert (libsystemd.module("daemon") is not None) is with_library
    yield request.param
    libsystemd.module.cache_clear()


def test_a_message_is_one_datagram_whose_values_stay_on_their_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(patience(5))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        notify("READY=1", "STATUS=away\nWATCHDOG=1")
        assert manager.recv(4096).decode() == "READY=1\nSTATUS=away\\nWATCHDOG=1"


def test_a_name_in_the_abstract_namespace(monkeypatch: pytest.MonkeyPatch, way: str) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("")
        manager.settimeout(patience(5))
        monkeypatch.setenv("NOTIFY_SOCKET", f"@{manager.getsockname()[1:].decode()}")
        notify("WATCHDOG=1")
        assert manager.recv(4096) == b"WATCHDOG=1"


def test_a_manager_that_does_not_read_is_reported_and_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, way: str
) -> None:
    monkeypatch.setattr(systemd, "_SEND_S", 0.05)
    with (
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as others,
    ):
        manager.bind(str(tmp_path / "notify"))
        others.connect(str(tmp_path / "notify"))
        others.setblocking(False)
        with suppress(BlockingIOError):
            while others.send(b"X_FULL=1"):
                pass
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        notify("WATCHDOG=1")
    assert [r.getMessage() for r in caplog.records] == [
        "cannot notify the service manager: timed out"
    ]


def test_a_manager_that_is_gone_is_reported_and_no_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, way: str
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "gone"))
    notify("READY=1")
    assert [r.getMessage() for r in caplog.records] == [
        "cannot notify the service manager: No such file or directory"
    ]
