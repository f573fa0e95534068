"""The hand's own process: receives its fingers' reports, publishes their objects, sees no frame and
opens no device. Each finger has its own pair of datagram sockets, so that none harms another, and
neither end waits.
"""

from __future__ import annotations

import contextlib
import itertools
import logging
import mmap
import selectors
import signal
import socket
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from tacshade_edge.daemon.systemd import notify, notify_stopping
from tacshade_edge.errors import DecodeError
from tacshade_edge.free_memory import share_free_memory
from tacshade_edge.hand.fingers import HandAggregator
from tacshade_edge.mqtt import links
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.pipeline.pipeline import Crash, crashes_to
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.settings import Hand, Settings
from tacshade_edge.types import Need
from tacshade_edge.wire import codec, requests
from tacshade_edge.wire.hand_messages import (
    away,
    decode_finger,
    encode_finger,
    encode_hand,
    finger_of,
)
from tacshade_edge.wire.hand_topics import Finger
from tacshade_edge.wire.health_topics import HandHealth
from tacshade_edge.wire.requests import Request

BYTES_MAX = 1 << 15


@dataclass(frozen=True, slots=True, eq=False)
class FingerLine:
    """A finger's end.

    If no hand's process reads it, the kernel takes some hundred messages and then no more.
    """

    sock: socket.socket
    shared: mmap.mmap

    @property
    def wanted(self) -> bool:
        return self.shared[0] != 0

    def report(self, finger: Finger) -> None:
        """Send a report, or drop it if there is no room; the next comes soon."""
        with contextlib.suppress(OSError):
            self.sock.send(encode_finger(finger))


class Lines:
    """All lines of a hand: the ends of its `fingers` and those of the `hand`,
    by the fingers' ids.
    """

    def __init__(self, names: Sequence[str]) -> None:
        # A byte that all processes see: each finger looks at it for each frame, without a system
        # call.
        self._wanted = mmap.mmap(-1, 1)
        self.fingers: dict[str, FingerLine] = {}
        self.hand: dict[str, socket.socket] = {}
        for name in names:
            ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
            ours.setblocking(False)
            # Neither end waits: a finger drops a report for a hand that hangs, and the hand takes
            # what is there.
            theirs.setblocking(False)
            self.hand[name], self.fingers[name] = ours, FingerLine(theirs, self._wanted)

    def end(self, name: str) -> None:
        """Report for a finger that its process has ended."""
        if name in self.fingers:
            self.fingers[name].report(
                away(Reason(ReasonCode.DAEMON_STOPPED, "the sensor's process has ended"))
            )

    def want(self, *, wanted: bool) -> None:
        """Notify all fingers whether somebody listens to the hand."""
        self._wanted[0] = wanted

    def take(self, name: str) -> Finger | None:
        """A finger's oldest report that waits; None if none does. Raises DecodeError."""
        try:
            return decode_finger(self.hand[name].recv(BYTES_MAX))
        except BlockingIOError:
            return None


# Without contact; in contact, every frame is reported.
PERIOD_NS: Final = 100_000_000


class FingerReporter(FrameObserver):
    """One sensor as a finger: while somebody listens to the hand, it requests depth and reports."""

    def __init__(self, line: FingerLine, hand_T_sensor: Rigid) -> None:
        self._line = line
        self._hand_T_sensor = hand_T_sensor
        self._reported: tuple[bool, bool, bool] | None = None
        self._reported_ns = 0

    def need(self) -> Need:
        return Need.DEPTH if self._line.wanted else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        """Report a frame's result: every one in contact, every change,
        and otherwise ten a second.
        """
        if (result := seen.reconstruction) is None or not self._line.wanted:
            self._reported = None
            return
        now = (result.contact, result.touched, result.valid)
        if (
            result.contact
            or now != self._reported
            or not 0 <= result.t_ns - self._reported_ns < PERIOD_NS
        ):
            self._reported, self._reported_ns = now, result.t_ns
            self._line.report(finger_of(result, self._hand_T_sensor))

    def settings_changed(self, settings: Settings) -> None:
        if settings.hand_T_sensor:
            self._hand_T_sensor = from_seven(settings.hand_T_sensor)

    def source_changed(self, source: SourceState) -> None:
        """Report that no usable frames come, even if nobody listens."""
        if source.reason:
            self._line.report(away(source.reason))


_log = logging.getLogger(__name__)

STREAM: Final = "objects"
TICK_S: Final = 1.0
# Of one finger, before the others have their turn.
AT_ONCE: Final = 64
# Between two checks for a new listener, a stop or a crash, none of which wakes the selector.
LOOK_S: Final = 0.25
STOPPED_S: Final = 1.9


class HandProcess:
    """One hand's conversation with its fingers and the broker.

    Raises ConfigError for settings that can never work.
    """

    def __init__(self, hand: Hand, lines: Lines) -> None:
        self._lines = lines
        self._aggregator = HandAggregator(hand.fingers)
        self._link = links.make_link(hand, self._on_request, lambda *_: None)
        self._began_s = time.monotonic()
        self._heard: Counter[str] = Counter(dict.fromkeys(hand.fingers, 0))
        self._undecodable = 0
        self._crashes: list[Crash] = []
        self._stopping = False
        self._selector = selectors.DefaultSelector()
        for name, line in lines.hand.items():
            self._selector.register(line, selectors.EVENT_READ, name)

    def stop(self) -> None:
        self._stopping = True

    def run(self) -> None:
        """Work until `stop`.

        Raises the exception that ended a thread; the broker then publishes the last will.
        """
        share_free_memory()
        with crashes_to(self._crashes.append):
            self._link.start()
            notify("READY=1")
            self._loop()
        notify_stopping()
        # Fingers would go on to compute depth for a hand that is gone.
        self._lines.want(wanted=False)
        self._publish_health()
        self._link.stop(STOPPED_S)
        self._selector.close()
        _log.info("stopped: %s", self._link.counters())

    def _loop(self) -> None:
        next_tick_s = time.monotonic()
        while not self._stopping:
            now_s, now_ns = time.monotonic(), time.monotonic_ns()
            if now_s >= next_tick_s:
                next_tick_s = now_s + TICK_S
                self._publish_health()
                reason = self._link.reason
                notify(f"STATUS={reason or 'publishing'}", "WATCHDOG=1")
            listened = self._link.has_listener(STREAM)
            self._lines.want(wanted=listened)
            self._aggregator.listen(now_ns, listened=listened)
            due_ns = self._aggregator.due_ns()
            if due_ns is not None and now_ns >= due_ns:
                message = self._aggregator.message(now_ns, time.time_ns())
                self._link.offer(STREAM, encode_hand(message), message.seq)
                continue
            wait_s = LOOK_S if due_ns is None else min(LOOK_S, (due_ns - now_ns) / 1e9)
            for key, _ in self._selector.select(max(0.0, min(wait_s, next_tick_s - now_s))):
                self._hear(key.data)
            if self._crashes:
                error = self._crashes[0].error
                error.add_note(f"in thread {self._crashes[0].thread}")
                raise error

    def _hear(self, name: str) -> None:
        """Take a finger's reports, but only so many at once: a finger may never stop."""
        try:
            for finger in itertools.islice(iter(partial(self._lines.take, name), None), AT_ONCE):
                self._heard[name] += 1
                self._aggregator.hear(name, finger, time.monotonic_ns())
        except DecodeError as error:
            self._undecodable += 1
            _log.warning("%s: %s", name, error)

    def _publish_health(self) -> None:
        health = HandHealth(
            wall_ns=time.time_ns(),
            uptime_s=round(time.monotonic() - self._began_s, 3),
            heard=dict(self._heard),
            undecodable=self._undecodable,
            mqtt=self._link.counters(),
        )
        self._link.set_retained("health", codec.encode_json(health), qos=0)

    def _on_request(self, request: Request) -> None:
        text = f"a hand accepts no requests; send req/{request.verb} to one of its sensors"
        self._link.reply(
            request, requests.encode_reply(request, Reason(ReasonCode.UNAVAILABLE, text))
        )


def run(hand: Hand, lines: Lines) -> None:
    """Run a hand's process until SIGTERM or SIGINT. Raises ConfigError as `HandProcess` does."""
    links.check_broker_files(hand.common)
    process = HandProcess(hand, lines)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: process.stop())
    # A reload changes only the fingers.
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    process.run()
