"""Several sensors on one machine: a process for each, forked from this one, which starts it again when it ends.

Forked after everything is imported, the processes share the libraries' memory (docs/decisions/0010-several-sensors.md);
and what happens in one, however bad, happens in no other. This process has no thread and does nothing with frames. It
is the service manager of its sensors and speaks with the real one for all: each gets a ``NOTIFY_SOCKET`` of ours.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import logging
import os
import selectors
import signal
import socket
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from tacshade_edge.core.profiles import DEFAULT, PROFILES
from tacshade_edge.daemon.systemd import STOP_USEC, notify
from tacshade_edge.devices.weights.network import runtime
from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import escaped
from tacshade_edge.settings import Document, load_all

_log = logging.getLogger(__name__)

RESTART_S = 1.0
WATCHDOG_S, ABORT_S = 10.0, 5.0
"""Silence after which a sensor's process is told to say where it hangs, and time for that before it is killed."""
TICK_S = 1.0
EXIT_CONFIG = 78
_PR_SET_PDEATHSIG = 1
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGCHLD)


@dataclass(slots=True, eq=False)
class _Sensor:
    """A sensor and its process.

    Attributes
    ----------
    pid : int
        0 while there is none.
    ready : bool
        It came up, or ended, since the supervisor started.
    heard_s : float or None
        When it last said that it works; None where it is not watched.
    again_s : float or None
        When it is to be started again; None where it is not.
    """

    document: Document
    notices: socket.socket
    pid: int = 0
    ready: bool = False
    heard_s: float | None = None
    again_s: float | None = None
    aborted_s: float | None = None
    status: str = "starting"
    code: int = field(default=0)

    @property
    def name(self) -> str:
        return self.document.settings.sensor_id


class Supervisor:
    """Keeps a process for each sensor.

    Parameters
    ----------
    documents : sequence of Document
        Of one file.
    """

    def __init__(self, documents: Sequence[Document]) -> None:
        self._path = documents[0].path
        self._selector = selectors.DefaultSelector()
        self._sensors = [_Sensor(document, _notice_socket()) for document in documents]
        for sensor in self._sensors:
            self._selector.register(sensor.notices, selectors.EVENT_READ, sensor)
        self._told_ready = False
        self._note = ""
        self._stopping_s: float | None = None

    def run(self) -> Document | int:
        """Keep them until a signal ends all, or none is left to start again.

        Returns
        -------
        In a sensor's process its document; in this one the exit code: 78 where no sensor's settings can work, else 0.
        """
        reader, writer = socket.socketpair()
        reader.setblocking(False)
        writer.setblocking(False)
        numbers = [number for number in _SIGNALS if number is not signal.SIGHUP or not os.isatty(0)]
        previous = {number: signal.signal(number, lambda *_: None) for number in numbers}
        wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
        self._selector.register(reader, selectors.EVENT_READ)
        if any(PROFILES.get(sensor.document.settings.profile, PROFILES[DEFAULT]).network for sensor in self._sensors):
            runtime()  # here, since each that imports it by itself has it for itself
        gc.collect()
        gc.freeze()  # the collector would write to every page, and so copy it

        def let_go() -> None:
            signal.set_wakeup_fd(wakeup)
            for number, handler in previous.items():
                signal.signal(number, handler)
            self._selector.close()
            for part in (reader, writer, *(sensor.notices for sensor in self._sensors)):
                part.close()

        try:
            return self._supervise(reader, let_go)
        finally:
            if self._selector.get_map() is not None:
                let_go()

    def _supervise(self, signals: socket.socket, let_go: Callable[[], None]) -> Document | int:
        for sensor in self._sensors:
            sensor.again_s = 0.0
        next_tick_s = 0.0
        while True:
            now_s = time.monotonic()
            for sensor in self._sensors:
                is_due = sensor.again_s is not None and now_s >= sensor.again_s
                if is_due and not self._start(sensor):
                    let_go()
                    return sensor.document
            if now_s >= next_tick_s:
                next_tick_s = now_s + TICK_S
                self._watch(now_s)
                self._tell()
            if self._is_over():
                return self._code()
            for key, _ in self._selector.select(0.1):
                if isinstance(key.data, _Sensor):
                    self._hear(key.data)
                else:
                    self._handle(set(signals.recv(4096)))
            self._reap()

    def _start(self, sensor: _Sensor) -> bool:
        """Fork; True in this process."""
        sensor.again_s = sensor.heard_s = sensor.aborted_s = None
        sensor.status = "starting"
        parent = os.getpid()
        sensor.pid = os.fork()
        if sensor.pid:
            return True
        os.environ["NOTIFY_SOCKET"] = "@" + sensor.notices.getsockname()[1:].decode()
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:  # it ended just now
            os._exit(0)
        return False

    def _hear(self, sensor: _Sensor) -> None:
        """Take a message that sensor's process means for the service manager."""
        with contextlib.suppress(OSError):
            for line in sensor.notices.recv(4096).decode(errors="replace").split("\n"):
                key, _, value = line.partition("=")
                if key == "STATUS":
                    sensor.status = value
                elif key == "STOPPING":
                    sensor.heard_s = None
                elif key in ("READY", "WATCHDOG"):
                    sensor.heard_s = time.monotonic()
                    sensor.ready = True

    def _handle(self, numbers: set[int]) -> None:
        if numbers & {signal.SIGTERM, signal.SIGINT} and self._stopping_s is None:
            self._stopping_s = time.monotonic()
            notify("STOPPING=1", f"EXTEND_TIMEOUT_USEC={STOP_USEC}", "STATUS=stopping")
            for sensor in self._sensors:
                sensor.again_s = sensor.heard_s = None
                _signal(sensor, signal.SIGTERM)
        elif signal.SIGHUP in numbers and self._stopping_s is None:
            self._reload()

    def _reload(self) -> None:
        """Have each sensor read the file again; start those that ended over their settings."""
        notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            documents = {document.settings.sensor_id: document for document in load_all(self._path)}
        except ConfigError as error:
            self._note = f"reload refused, the running settings stay: {error}"
        else:
            names = [sensor.name for sensor in self._sensors]
            self._note = "" if list(documents) == names else "restart to use the new sensors"
            for sensor in self._sensors:
                if document := documents.get(sensor.name):
                    sensor.document = document
                    if sensor.pid:
                        _signal(sensor, signal.SIGHUP)
                    else:
                        sensor.again_s = 0.0
        _log.log(logging.WARNING if self._note else logging.INFO, "%s", self._note or "reloaded")
        notify("READY=1")

    def _watch(self, now_s: float) -> None:
        """End what hangs."""
        for sensor in self._sensors:
            if sensor.aborted_s is not None and now_s > sensor.aborted_s + ABORT_S:
                _signal(sensor, signal.SIGKILL)
            elif sensor.aborted_s is None and sensor.heard_s is not None and now_s > sensor.heard_s + WATCHDOG_S:
                _log.error("%s: hangs for %.0f s, ended", sensor.name, WATCHDOG_S)
                sensor.aborted_s = now_s
                _signal(sensor, signal.SIGABRT)
        if self._stopping_s is not None and now_s > self._stopping_s + STOP_USEC / 1e6:
            for sensor in self._sensors:
                _signal(sensor, signal.SIGKILL)

    def _reap(self) -> None:
        """Decide what follows on a process that ended."""
        for sensor in self._sensors:
            if not sensor.pid:
                continue
            pid, status = os.waitpid(sensor.pid, os.WNOHANG)
            if not pid:
                continue
            sensor.pid, sensor.code = 0, os.waitstatus_to_exitcode(status)
            sensor.ready, sensor.heard_s, sensor.aborted_s = True, None, None
            if self._stopping_s is not None or sensor.code == 0:
                sensor.status = "ended"
            elif sensor.code == EXIT_CONFIG:
                sensor.status = "bad configuration, see the log; reload when it is mended"
            else:
                sensor.status = f"ended with {sensor.code}, starts again"
                sensor.again_s = time.monotonic() + RESTART_S
                _log.error("%s: its process ended with %d, starts again in %.0f s", sensor.name, sensor.code, RESTART_S)

    def _tell(self) -> None:
        """Status and watchdog, for all; readiness once each sensor came up or ended."""
        if not self._told_ready and all(sensor.ready for sensor in self._sensors):
            self._told_ready = True
            notify("READY=1")
        told = "; ".join(f"{sensor.name}: {sensor.status}" for sensor in self._sensors)
        notify("WATCHDOG=1", f"STATUS={escaped(told)}{f'; {self._note}' if self._note else ''}")

    def _is_over(self) -> bool:
        return all(not sensor.pid and sensor.again_s is None for sensor in self._sensors)

    def _code(self) -> int:
        codes = {sensor.code for sensor in self._sensors}
        return EXIT_CONFIG if codes == {EXIT_CONFIG} else 0


def _notice_socket() -> socket.socket:
    """For one sensor's messages, at a name that the kernel chooses."""
    notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notices.bind("")
    notices.setblocking(False)
    return notices


def _signal(sensor: _Sensor, number: signal.Signals) -> None:
    if sensor.pid:
        os.kill(sensor.pid, number)
