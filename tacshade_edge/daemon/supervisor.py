"""Several sensors on one machine: one process for each, and for their hand, forked from this one,
which restarts those that end.

Forked after everything is imported, the processes share the libraries' memory
(docs/decisions/0010-several-sensors.md). This process has no thread. It is its sensors' service
manager and speaks to the real one for all of them: each gets a ``NOTIFY_SOCKET`` of ours.
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
from dataclasses import dataclass

from tacshade_edge.daemon.systemd import STOP_USEC, notify, notify_reloading, notify_stopping
from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import escaped
from tacshade_edge.sensor.inference.network import preload
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.settings import Document, Hand, load_all, load_hand
from tacshade_edge.version import installed_version

_log = logging.getLogger(__name__)

RESTART_S, RESTART_MAX_S = 1.0, 60.0
STEADY_S = 30.0
"""A part that ends before it is this old waits twice as long as the last time."""
WATCHDOG_S, ABORT_S = 10.0, 5.0
"""Silence after which a process is aborted to report where it hangs,
and time for that before it is killed.
"""
TICK_S = 1.0
EXIT_CONFIG = 78
EXIT_STOPPED = 128 + signal.SIGTERM
"""Exit code of a part that a signal stopped; 0 is the end of a finite source,
which is not restarted.
"""
_PR_SET_PDEATHSIG = 1
_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGCHLD)


@dataclass(slots=True, eq=False)
class _Part:
    """A sensor or the hand, and its process."""

    of: Document | Hand
    notices: socket.socket
    pid: int = 0
    ready: bool = False  # it has come up, or ended, since the supervisor started
    heard_s: float | None = None  # when it last reported that it works; None if it is not watched
    again_s: float | None = 0.0  # when to start it again; None: not at all
    aborted_s: float | None = None
    began_s: float = 0.0
    wait_s: float = 0.0  # before its latest start, if that followed an end
    status: str = "starting"
    code: int = 0

    @property
    def name(self) -> str:
        return name_of(self.of)


class Supervisor:
    """Keeps a process running for each sensor and for their hand;
    `ended` receives the id of each that ends.
    """

    def __init__(
        self,
        documents: Sequence[Document],
        hand: Hand | None = None,
        ended: Callable[[str], None] = lambda name: None,
    ) -> None:
        self._path = documents[0].path
        self._ended = ended
        self._selector = selectors.DefaultSelector()
        self._sensors = [_Part(document, _notice_socket()) for document in documents]
        self._parts = [*self._sensors, *([_Part(hand, _notice_socket())] if hand else [])]
        for part in self._parts:
            self._selector.register(part.notices, selectors.EVENT_READ, part)
        self._closing = contextlib.ExitStack()
        self._reported_ready = False
        self._note = ""
        self._stopping_s: float | None = None

    def run(self, work: Callable[[Document | Hand], int]) -> int:
        """Run the processes until a signal ends all, or no sensor is left to restart; return the
        exit code: in a process that it starts that of `work`, which is called there; in this one 78
        if no sensor's settings can work, else 0.
        """
        reader, writer = socket.socketpair()
        reader.setblocking(False)
        writer.setblocking(False)
        self._selector.register(reader, selectors.EVENT_READ)
        with self._closing as closing:
            for end in (reader, writer, *(part.notices for part in self._parts)):
                closing.callback(end.close)
            closing.callback(self._selector.close)
            for number in _SIGNALS:
                # From a terminal, SIGHUP is the end of the terminal; else it asks for a reload.
                if number is not signal.SIGHUP or not os.isatty(0):
                    closing.callback(signal.signal, number, signal.signal(number, lambda *_: None))
            # A handler may interrupt any line; a number in a socket waits until the loop reads it.
            wakeup = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
            closing.callback(signal.set_wakeup_fd, wakeup)
            for part in self._sensors:
                # In this process, so that those that it forks share the networks' memory.
                if isinstance(part.of, Document):
                    preload(PROFILES.get(part.of.settings.profile, PROFILES[DEFAULT]))
            # For the same reason: the codec that a broker's name needs, 2 MB with its tables, and
            # the module that finds the version.
            "localhost".encode("idna")
            installed_version()
            gc.collect()
            # Else the collector writes to every page and so copies it.
            gc.freeze()
            mine = self._supervise(reader)
        return self._code() if mine is None else work(mine)

    def _supervise(self, signals: socket.socket) -> Document | Hand | None:
        """Supervise until all is over (None); in a process that it starts,
        return what that process is to do.
        """
        next_tick_s = 0.0
        while True:
            now_s = time.monotonic()
            for part in self._parts:
                if part.again_s is not None and now_s >= part.again_s and not self._start(part):
                    return part.of
            if now_s >= next_tick_s:
                next_tick_s = now_s + TICK_S
                self._watch(now_s)
                self._report()
            if self._is_over(self._sensors):
                if self._is_over(self._parts):
                    return None
                self._stop()
            # Signals end the wait; its limit is how late a part may start again.
            for key, _ in self._selector.select(0.1):
                if isinstance(key.data, _Part):
                    self._hear(key.data)
                else:
                    numbers = set(signals.recv(4096))
                    if numbers & {signal.SIGTERM, signal.SIGINT}:
                        self._stop()
                    elif signal.SIGHUP in numbers and self._stopping_s is None:
                        self._reload()
            self._reap()

    def _start(self, part: _Part) -> bool:
        """Fork; return True in this process."""
        part.again_s = part.heard_s = part.aborted_s = None
        part.status, part.began_s = "starting", time.monotonic()
        parent = os.getpid()
        # Until the child has its own handlers and socket, a signal for it would be written to our
        # pipe, which both still share.
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            try:
                part.pid = os.fork()
            except OSError as error:
                self._start_again(
                    part, f"cannot start its process: {os.strerror(error.errno or 0)}"
                )
                return True
            if part.pid:
                return True
            # Its own group: if this process is killed,
            # the kernel wakes a stopped group that it leaves behind.
            os.setpgid(0, 0)
            # The part reports to us; only we report to the real service manager.
            os.environ["NOTIFY_SOCKET"] = "@" + part.notices.getsockname()[1:].decode()
            self._closing.close()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        # The kernel signals only ends that come after prctl: the parent may have ended before.
        if os.getppid() != parent:
            os._exit(0)
        return False

    def _hear(self, part: _Part) -> None:
        """Take a message from a part's process to the service manager."""
        with contextlib.suppress(OSError):
            for line in part.notices.recv(4096).decode(errors="replace").split("\n"):
                key, _, value = line.partition("=")
                if key == "STATUS":
                    part.status = value
                elif key == "STOPPING":
                    part.heard_s = None
                elif key in ("READY", "WATCHDOG"):
                    part.heard_s = time.monotonic()
                    part.ready = True

    def _stop(self) -> None:
        if self._stopping_s is not None:
            return
        self._stopping_s = time.monotonic()
        notify_stopping()
        for part in self._parts:
            part.again_s = part.heard_s = None
            _signal(part, signal.SIGTERM)

    def _reload(self) -> None:
        """Make each part read the file again; start those that ended because of their settings."""
        notify_reloading()
        try:
            documents = load_all(self._path)
            hand = load_hand(self._path)
        except ConfigError as error:
            self._note = f"rejected the reload and kept the running settings: {error}"
        else:
            of_file: list[Document | Hand] = [*documents, *([hand] if hand else [])]
            now = {name_of(of): of for of in of_file}
            self._note = (
                ""
                if list(now) == [part.name for part in self._parts]
                else "restart to use the new sensors"
            )
            for part in self._parts:
                if of := now.get(part.name):
                    part.of = of
                    if part.pid:
                        _signal(part, signal.SIGHUP)
                    else:
                        part.again_s = part.wait_s = 0.0
        _log.log(logging.WARNING if self._note else logging.INFO, "%s", self._note or "reloaded")
        notify("READY=1")

    def _watch(self, now_s: float) -> None:
        for part in self._parts:
            if part.aborted_s is not None and now_s > part.aborted_s + ABORT_S:
                _signal(part, signal.SIGKILL)
            elif (
                part.aborted_s is None
                and part.heard_s is not None
                and now_s > part.heard_s + WATCHDOG_S
            ):
                _log.error(
                    "%s: ending the process, which has not responded for %.0f s",
                    part.name,
                    WATCHDOG_S,
                )
                # SIGABRT first: Python's fault handler then logs where every thread hung.
                part.aborted_s = now_s
                _signal(part, signal.SIGABRT)
        if self._stopping_s is not None and now_s > self._stopping_s + STOP_USEC / 1e6:
            for part in self._parts:
                _signal(part, signal.SIGKILL)

    def _reap(self) -> None:
        """Decide what follows the end of a process."""
        for part in self._parts:
            if not part.pid:
                continue
            pid, status = os.waitpid(part.pid, os.WNOHANG)
            if not pid:
                continue
            part.pid, part.code = 0, os.waitstatus_to_exitcode(status)
            part.ready, part.heard_s, part.aborted_s = True, None, None
            self._ended(part.name)
            if self._stopping_s is not None or part.code == 0:
                part.status = "ended"
            elif part.code == EXIT_CONFIG:
                part.status = "bad settings, see the log; reload once they are fixed"
            elif part.code == EXIT_STOPPED:
                # Somebody else's signal, since a stop of ours is handled above: the hand must
                # not lose a finger by it.
                self._start_again(part, "a signal ended its process")
            else:
                self._start_again(part, f"its process exited with {part.code}")

    def _start_again(self, part: _Part, why: str) -> None:
        now_s = time.monotonic()
        part.wait_s = restart_wait_s(part.wait_s, now_s - part.began_s)
        part.again_s = now_s + part.wait_s
        part.status = f"{why}; restarting in {part.wait_s:.0f} s"
        _log.error("%s: %s", part.name, part.status)

    def _report(self) -> None:
        """Send status and watchdog messages for all,
        and readiness once each part has come up or ended.
        """
        if not self._reported_ready and all(part.ready for part in self._parts):
            self._reported_ready = True
            notify("READY=1")
        statuses = "; ".join(f"{part.name}: {part.status}" for part in self._parts)
        notify("WATCHDOG=1", f"STATUS={escaped(statuses)}{f'; {self._note}' if self._note else ''}")

    def _is_over(self, parts: Sequence[_Part]) -> bool:
        return all(not part.pid and part.again_s is None for part in parts)

    def _code(self) -> int:
        # Only if no sensor can ever work: systemd does not start a service again after this code.
        codes = {sensor.code for sensor in self._sensors}
        return EXIT_CONFIG if codes == {EXIT_CONFIG} else 0


def restart_wait_s(waited_s: float, ran_s: float) -> float:
    """How long a process waits that waited so long for its latest start, and ran so long then."""
    if ran_s >= STEADY_S:
        return RESTART_S
    return min(max(2 * waited_s, RESTART_S), RESTART_MAX_S)


def name_of(part: Document | Hand) -> str:
    """A sensor's id, or the hand's name, which no sensor can have."""
    return f"hand/{part.hand_id}" if isinstance(part, Hand) else part.settings.sensor_id


def _notice_socket() -> socket.socket:
    """A socket for one part's messages, at a name that the kernel chooses."""
    notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notices.bind("")
    notices.setblocking(False)
    return notices


def _signal(part: _Part, number: signal.Signals) -> None:
    if part.pid:
        os.kill(part.pid, number)
