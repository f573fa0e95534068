"""A robot on a pty: it moves, reports its poses and keeps its clock, with the requested faults.

::

    .venv/bin/python -m support.robot --link /dev/shm/robot [--rate 100] [--binary]
        [--seconds 20] [--line usb|loaded|ftdi] [--drift-ppm 40] [--lose 0.01] [--damage 0.01]
        [--stall 5:0.3] [--reboot 10] [--one-way]

Point `serial.device` at the link. At the end it prints what it sent as JSON. Each pose takes a
number, whether or not the line then loses it, so ``health.serial`` must account for all: poses +
poses_lost (+ those at the very end).
"""

from __future__ import annotations

import argparse
import contextlib
import heapq
import json
import math
import os
import pty
import random
import select
import threading
import time
import tty
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import cobs_decode, cobs_encode
from tacshade_edge.robot.line import parse_line, seal
from tacshade_edge.robot.pose import PoseSample, PoseValues, encode_pose

Delay = Callable[[random.Random], float]


@dataclass(frozen=True, slots=True)
class LineModel:
    """A kind of line: its delays towards the daemon and back to the robot."""

    to_daemon_s: Delay
    to_robot_s: Delay


def _usb(rng: random.Random) -> float:
    """The host polls every millisecond, at a phase that wanders;
    then the kernel wakes the reader.
    """
    return 0.0001 + rng.uniform(0, 0.001) + rng.expovariate(1 / 0.00005)


def _loaded(rng: random.Random) -> float:
    """The same on a board whose cores are all busy:
    the scheduler's slices on top, now and then many.
    """
    return (
        _usb(rng)
        + rng.expovariate(1 / 0.001)
        + (rng.uniform(0.005, 0.03) if rng.random() < 0.05 else 0)
    )


def _ftdi(rng: random.Random) -> float:
    """The chip sends its buffer every 16 ms, whenever the bytes came."""
    return 0.0002 + rng.uniform(0, 0.016) + rng.expovariate(1 / 0.00005)


LINES = {
    "usb": LineModel(_usb, _usb),
    "loaded": LineModel(_loaded, _loaded),
    "ftdi": LineModel(_ftdi, _usb),
}


class Clock:
    """The robot's clock: an offset, and a drift that wanders by a ppm over ten minutes."""

    def __init__(self, offset_s: float, drift_ppm: float) -> None:
        self._offset_s, self._drift = offset_s, drift_ppm * 1e-6

    def read_ns(self, true_s: float) -> int:
        """The clock's reading in ns at a true time in s."""
        wander_s = 1e-6 * 600 / math.tau * (1 - math.cos(true_s * math.tau / 600))
        return round(1e9 * (self._offset_s + true_s * (1 + self._drift) + wander_s))


REPLY_S = 0.5
SYNC_S, FIRST_SYNCS, FIRST_SYNC_S = 1.0, 8, 0.1


def motion(at_s: float) -> PoseValues:
    """The flange's pose: a circle of 40 mm in 4 s, rocking by 20 degrees about x."""
    phase = math.tau * at_s / 4
    half = math.radians(10) * math.sin(phase)
    return (
        40 * math.cos(phase),
        40 * math.sin(phase),
        300.0,
        math.cos(half),
        math.sin(half),
        0.0,
        0.0,
    )


@dataclass(slots=True)
class Faults:
    """Faults and how often they occur: shares of all lines and frames; stalls as (every s, for s);
    reboots every s.
    """

    lose: float = 0.0
    damage: float = 0.0
    stall_s: tuple[float, float] = (0.0, 0.0)
    reboot_s: float = 0.0


@dataclass(slots=True)
class Counts:
    """Counts of what the robot sent and received."""

    poses: int = 0
    last_pose_seq: int = -1
    lost: int = 0
    damaged: int = 0
    boots: int = 0
    syncs: int = 0
    syncs_answered: int = 0
    bad_replies: int = 0
    errors: int = 0


class PtyRobot:
    """A robot in its own thread.

    `link` becomes a symbolic link to the pty's other end, also after `plug`. The robot sends
    `rate_hz` poses per second (0: none), but at most `poses`, and goes on without them; `where` is
    its pose at a time of `true_s`.
    """

    def __init__(
        self,
        link: Path,
        *,
        rate_hz: float = 100.0,
        binary: bool = False,
        one_way: bool = False,
        poses: int | None = None,
        line: LineModel | None = None,
        clock: Clock | None = None,
        faults: Faults | None = None,
        seed: int = 1,
        where: Callable[[float], PoseValues] = motion,
    ) -> None:
        self.counts = Counts()
        self._where = where
        self.events: list[str] = []  # EVT lines
        self.replies: dict[int, str] = {}
        self.answers: list[str] = []  # to commands, in order
        self._link = link
        self._rate_hz, self._binary, self._one_way, self.poses_max = rate_hz, binary, one_way, poses
        self._line = line
        self.clock = clock or Clock(123.0, 40.0)
        self.faults = faults or Faults()
        self._rng = random.Random(seed)
        self.began_s = time.monotonic()
        self._lock = threading.Lock()
        self._fds: tuple[int, int] | None = None
        self._out: list[tuple[float, int, bytes]] = []
        self._in: list[tuple[float, int, bytes]] = []
        self._order = 0
        self._buffer = b""
        self._typed: list[str] = []
        self._asked_seqs: set[int] = set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="robot", daemon=True)
        self._boot()

    def __enter__(self) -> PtyRobot:
        self.plug()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(10)
        self.unplug()

    def plug(self) -> None:
        """Put a new pty behind the link."""
        master, slave = pty.openpty()
        tty.setraw(slave)
        fresh = self._link.with_name(f"{self._link.name}.new")
        fresh.unlink(missing_ok=True)
        fresh.symlink_to(os.ttyname(slave))
        fresh.replace(self._link)
        os.set_blocking(master, False)
        with self._lock:
            self._fds = master, slave

    @property
    def master(self) -> int:
        """The robot's end of the pty, while it is plugged in."""
        assert self._fds is not None
        return self._fds[0]

    def number_from(self, number: int) -> None:
        """Give the next command this number, whatever came before."""
        self._seq = number - 1

    def unplug(self) -> None:
        """Remove the pty, like a pulled cable; bytes in transit are lost."""
        with self._lock:
            fds, self._fds = self._fds, None
            self._out.clear()
            self._in.clear()
            self._buffer = b""
        for fd in fds or ():
            os.close(fd)
        self._link.unlink(missing_ok=True)

    def stop_talking(self) -> None:
        """Hang with the cable plugged in."""
        self._stop.set()

    def ask(self, text: str) -> None:
        """Send a command with the next number; its reply comes to `answers`,
        without the checksum.
        """
        self._typed.append(text)

    def true_s(self) -> float:
        """The current time for `motion`."""
        return time.monotonic() - self.began_s

    def _boot(self) -> None:
        self.counts.boots += 1
        self._mode_binary = False
        self._seq = self._pose_seq = 0
        self._state = "hello"
        self._asked_s = -math.inf
        self._sync: tuple[int, int] | None = None  # number and t1 of the one that waits
        self._t4: int | None = None
        self._next_sync_s, self._syncs = 0.0, 0
        self._unanswered = 0
        self._pose_at_s = self.true_s()

    def _run(self) -> None:
        boot_s, stall_s = 0.0, self.faults.stall_s
        while not self._stop.is_set():
            now_s = self.true_s()
            if self.faults.reboot_s and now_s - boot_s > self.faults.reboot_s:
                boot_s = now_s
                self.clock = Clock(1.0 - now_s, 40.0)  # begins a second after 0
                self._boot()
            stalled = bool(stall_s[0]) and now_s % stall_s[0] > stall_s[0] - stall_s[1]
            if not stalled:
                self._talk(now_s)
            self._carry(now_s, stalled)
            with self._lock:
                master = self._fds[0] if self._fds else None
            if master is None:
                self._stop.wait(0.005)
            else:
                with contextlib.suppress(OSError, ValueError):  # unplugged just now
                    select.select([master], [], [], 0.0005)

    def _talk(self, now_s: float) -> None:
        if self._state in ("hello", "mode"):
            if now_s - self._asked_s > REPLY_S:
                if (
                    self._state == "mode" and self._asked_s > 0
                ):  # did it change its mode? HELLO is heard in both
                    self._state = "hello"
                self._asked_s = now_s
                text = (
                    f"HELLO 1 crc=req boot=b{self.counts.boots}"
                    if self._state == "hello"
                    else "MODE BIN"
                )
                if self._state == "hello":
                    self._mode_binary = False
                    self._send(
                        b"\n", now_s, plain=True
                    )  # ends what a robot before this one may have begun
                self._command(text, now_s)
            if not self._one_way:
                return
        while self._typed:
            self._command(self._typed.pop(0), now_s)
            self._asked_seqs.add(self._seq)
        if not self._one_way and now_s >= self._next_sync_s:
            self._ask_sync(now_s)
        period_s = 1 / self._rate_hz if self._rate_hz else math.inf
        if now_s - self._pose_at_s > 0.5:
            self._pose_at_s = now_s  # not all that was missed
        while self._pose_at_s + period_s <= now_s and (
            self.poses_max is None or self.counts.poses < self.poses_max
        ):
            self._pose_at_s += period_s
            self._send_pose(self._pose_at_s, now_s)

    def _ask_sync(self, now_s: float) -> None:
        self._unanswered = self._unanswered + 1 if self._sync else 0
        if self._unanswered >= 3:
            self._state, self._asked_s, self._unanswered, self._sync = "hello", -math.inf, 0, None
            return
        t1 = self.clock.read_ns(self.true_s())
        self._sync = self._seq + 1, t1
        self._command(f"SYNC {t1}" if self._t4 is None else f"SYNC {t1} {self._t4}", now_s)
        self._t4 = None
        self._syncs += 1
        self.counts.syncs += 1
        self._next_sync_s = now_s + (FIRST_SYNC_S if self._syncs < FIRST_SYNCS else SYNC_S)

    def _send_pose(self, at_s: float, now_s: float) -> None:
        self.counts.poses += 1
        self.counts.last_pose_seq = self._pose_seq
        sample = PoseSample(self._pose_seq, self.clock.read_ns(at_s), self._where(at_s))
        self._pose_seq = (self._pose_seq + 1) % 65536
        if self._mode_binary:
            self._send(cobs_encode(encode_pose(sample)) + b"\0", now_s)
        else:
            values = " ".join(f"{value:.6g}" for value in sample.values)
            self._send(seal(f"#{sample.seq} POSE {sample.t_ns} {values}"), now_s)

    def _command(self, text: str, now_s: float) -> None:
        self._seq = (self._seq + 1) % 65536
        line = seal(f"#{self._seq} {text}")
        self._send(cobs_encode(b"L" + line[:-1]) + b"\0" if self._mode_binary else line, now_s)

    def _send(self, data: bytes, now_s: float, *, plain: bool = False) -> None:
        if not plain and self._rng.random() < self.faults.lose:
            self.counts.lost += 1
            return
        if not plain and self._rng.random() < self.faults.damage:
            self.counts.damaged += 1
            at = self._rng.randrange(len(data) - 1)
            data = data[:at] + bytes([data[at] ^ 1 << self._rng.randrange(8)]) + data[at + 1 :]
        due_s = now_s + (self._line.to_daemon_s(self._rng) if self._line else 0)
        if self._out:  # bytes do not overtake
            due_s = max(due_s, max(self._out)[0])
        self._order += 1
        with self._lock:
            heapq.heappush(self._out, (due_s, self._order, data))

    def _carry(self, now_s: float, stalled: bool) -> None:
        with self._lock:
            fds = self._fds
            if fds is None:
                self._out.clear()  # said into a cable that is pulled
                return
            while self._out and self._out[0][0] <= now_s and not stalled:
                due_s, order, data = heapq.heappop(self._out)
                try:
                    written = os.write(fds[0], data)
                except BlockingIOError:
                    written = 0
                if written < len(data):  # nobody reads yet; a real line would lose it
                    heapq.heappush(self._out, (due_s, order, data[written:]))
                    break
            try:
                data = os.read(fds[0], 4096)
            except OSError:
                data = b""
            if data:
                self._order += 1
                due_s = now_s + (self._line.to_robot_s(self._rng) if self._line else 0)
                heapq.heappush(self._in, (due_s, self._order, data))
            arrived = []
            while self._in and self._in[0][0] <= now_s:
                arrived.append(heapq.heappop(self._in)[2])
        for data in arrived:
            self._hear(data, self.clock.read_ns(self.true_s()))

    def _hear(self, data: bytes, t4_ns: int) -> None:
        """Decode both modes at once: a line has no zero,
        and no frame is so short that its first byte is a LF.
        """
        self._buffer += data
        while (
            end := min((i for i in map(self._buffer.find, (b"\n", b"\0")) if i >= 0), default=-1)
        ) >= 0:
            raw, zero, self._buffer = (
                self._buffer[:end],
                self._buffer[end] == 0,
                self._buffer[end + 1 :],
            )
            try:
                line = parse_line(cobs_decode(raw)[1:] if zero else raw) if raw else None
            except DecodeError as error:
                line = Reason(ReasonCode.NOT_A_LINE, str(error))
            if isinstance(line, Reason):
                self.counts.bad_replies += 1
            elif line is not None and line.verb == "EVT":
                self.events.append(" ".join(line.args))
            elif line is not None and line.args[0].isdecimal():
                self._reply(int(line.args[0]), line.verb, line.text, t4_ns)
            elif line is not None:
                self.counts.errors += 1

    def _reply(self, seq: int, word: str, text: str, t4_ns: int) -> None:
        self.replies[seq] = text
        if seq in self._asked_seqs:
            self._asked_seqs.remove(seq)
            self.answers.append(text)
        self.counts.errors += word == "ERR"
        if self._sync and seq == self._sync[0]:
            self._sync, self._t4 = None, t4_ns
            self.counts.syncs_answered += 1
        elif word == "OK" and seq == self._seq and self._state == "hello":
            self._state, self._asked_s = ("mode" if self._binary else "run"), -math.inf
        elif word == "OK" and seq == self._seq and self._state == "mode":
            self._state, self._mode_binary = "run", True


def main() -> None:
    """Run until the time is over or until Ctrl-C."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--link", type=Path, required=True, help="under /dev, for serial.device: /dev/shm/robot"
    )
    parser.add_argument("--rate", type=float, default=100.0)
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--binary", action="store_true")
    parser.add_argument("--one-way", action="store_true")
    parser.add_argument("--line", choices=LINES)
    parser.add_argument("--drift-ppm", type=float, default=40.0)
    parser.add_argument("--lose", type=float, default=0.0)
    parser.add_argument("--damage", type=float, default=0.0)
    parser.add_argument(
        "--stall",
        type=lambda t: tuple(map(float, t.split(":"))),
        default=(0.0, 0.0),
        metavar="EVERY:FOR",
    )
    parser.add_argument("--reboot", type=float, default=0.0, metavar="EVERY")
    args = parser.parse_args()
    if not args.link.absolute().is_relative_to("/dev"):
        found = f"found {args.link}, expected a path such as /dev/shm/robot"
        parser.error(
            f"--link: {found}: serial.device takes a path under /dev only, where serial ports are"
        )
    robot = PtyRobot(
        args.link,
        rate_hz=args.rate,
        binary=args.binary,
        one_way=args.one_way,
        line=LINES[args.line] if args.line else None,
        clock=Clock(123.0, args.drift_ppm),
        faults=Faults(args.lose, args.damage, args.stall, args.reboot),
    )
    pause = threading.Event()
    with robot, contextlib.suppress(KeyboardInterrupt):
        pause.wait(min(args.seconds, 1e6))
    print(json.dumps(asdict(robot.counts)))


if __name__ == "__main__":
    main()
