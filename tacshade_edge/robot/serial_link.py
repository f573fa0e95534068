"""The robot's serial channel without its port: bytes in, commands and poses out;
answers in, bytes out.

A link outlives its port: when its cable is plugged in again, the robot continues where it was.
Answers depend only on the received bytes: there is no clock and no waiting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from tacshade_edge.errors import DecodeError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import Framing, LinkCounts, Mode, cobs_decode, cobs_encode
from tacshade_edge.robot.line import SEQ_MODULO, Line, crc16, parse_line, seal
from tacshade_edge.robot.pose import PoseSample, PoseSequence, decode_pose, parse_pose
from tacshade_edge.robot.verbs import (
    PROTOCOL_VERSION,
    Command,
    answer_text,
    help_text,
    parse_command,
    parse_hello,
)
from tacshade_edge.wire.results import CommandResult

# Poses come up to a thousand times a second: as many answers would fill the line.
BAD_POSE_PERIOD_NS: Final = 1_000_000_000
REPLIES_KEPT: Final = 64
# A robot, or a shell at the other end, may echo what we send; answering it would never end.
_OURS: Final = frozenset({"OK", "ERR", "EVT"})


@dataclass(frozen=True, slots=True)
class PoseArrived:
    """A pose, its time of arrival, and how many poses before it are missing by number."""

    sample: PoseSample
    arrived_ns: int
    missing: int


@dataclass(frozen=True, slots=True)
class Greeted:
    """A robot restarted: its clock and its numbers are unknown again.

    `boot` is empty if the robot gave none.
    """

    boot: str


Received = Command | PoseArrived | Greeted


@dataclass(slots=True)
class _Entry:
    """A numbered line; `reply` is None while its command is still in progress."""

    text: str
    command: Command
    reply: str | None = None


class ReplyCache:
    """The newest numbers of one session, from one ``HELLO``, whose number is `newest`, to the next.

    Each number is executed once, and its reply is kept for repeats.
    """

    def __init__(self, newest: int | None = None) -> None:
        self._newest = newest
        self._entries: dict[int, _Entry] = {}

    def admit(self, text: str, command: Command) -> _Entry | Reason | None:
        """Register a numbered line: None if it must be executed, its entry if it was before,
        or why it is rejected.
        """
        seq = command.seq
        if seq is None:
            return None
        known = self._entries.get(seq)
        if known is not None:
            if known.text == text:
                return known
            return Reason(
                ReasonCode.NUMBER_REUSED, "found the number of another line, expected a new number"
            )
        behind = 0 if self._newest is None else (self._newest - seq) % SEQ_MODULO
        # Its reply may be gone: it may have been executed.
        if REPLIES_KEPT <= behind < SEQ_MODULO // 2:
            text = f"found an old line number, expected HELLO or a number above #{self._newest}"
            return Reason(ReasonCode.NUMBER_STALE, text)
        if self._newest is None or behind >= SEQ_MODULO // 2:
            self._newest = seq
            # By number, not by age: the robot may leave numbers out.
            for old in [s for s in self._entries if (seq - s) % SEQ_MODULO >= REPLIES_KEPT]:
                del self._entries[old]
        self._entries[seq] = _Entry(text, command)
        return None

    def keep(self, command: Command, reply: str) -> bool:
        """Keep the reply to a command; False if its number no longer belongs to it."""
        if command.seq is None:
            return True
        entry = self._entries.get(command.seq)
        if entry is None or entry.command is not command:
            return False
        entry.reply = reply
        return True


@dataclass(slots=True)
class _Session:
    """The state from one HELLO to the next."""

    boot: str = ""
    crc_required: bool = False
    replies: ReplyCache = field(default_factory=ReplyCache)


class SerialLink:
    """One robot's channel."""

    def __init__(self) -> None:
        self.counts = LinkCounts()
        self._framing = Framing(self.counts)
        self._session = _Session()
        self._poses = PoseSequence()
        self._output = bytearray()
        self._bad_pose_answered_ns: int | None = None

    @property
    def mode(self) -> Mode:
        """``ASCII`` or ``BIN``."""
        return self._framing.mode

    def receive(self, data: bytes, now_ns: int) -> list[Received]:
        """Process the next bytes, however they are split, which arrived at `now_ns`.

        Returns the caller's tasks, in order; each `Command` needs one `answer`, now or later.
        """
        self.counts.bytes += len(data)
        self._framing.feed(data)
        received: list[Received] = []
        while (unit := self._framing.next_unit()) is not None:
            received += (
                self._line(unit.raw, now_ns) if unit.is_line else self._frame(unit.raw, now_ns)
            )
        return received

    def answer(self, command: Command, outcome: CommandResult | Reason) -> None:
        """Answer ``OK`` or ``ERR``; ignore a command of an earlier session,
        whose number may mean another one now.
        """
        text = answer_text(command.seq, outcome, command.verb)
        if self._session.replies.keep(command, text):
            self._send(text)

    def notify(self, event: str) -> None:
        """Send an unsolicited ``EVT``."""
        self._send(f"EVT {event}")

    def take_output(self) -> bytes:
        """Return the bytes to write to the port and forget them."""
        output = bytes(self._output)
        self._output.clear()
        return output

    def interrupted(self) -> None:
        """Discard partial input and pending output after the port was lost;
        keep everything else.
        """
        self._framing.clear()
        self._output.clear()

    def _send(self, text: str) -> None:
        line = seal(text)
        self._output += line if self.mode == "ASCII" else cobs_encode(b"L" + line[:-1]) + b"\0"

    def _refuse(self, seq: int | None, reason: Reason) -> None:
        """Answer ``ERR`` to a line that was not passed on as a command."""
        self.counts.refused += 1
        self._send(answer_text(seq, reason))

    def _frame(self, frame: bytes, now_ns: int) -> Iterator[Received]:
        try:
            raw = cobs_decode(frame)
        except DecodeError:
            self.counts.discard(len(frame))
            return
        if raw[:1] == b"L":
            yield from self._line(raw[1:].rstrip(b"\r\n"), now_ns)
            return
        try:
            sample = decode_pose(raw)
        except DecodeError as error:
            # Undamaged but wrong is a mistake in the robot's program, which its developer must
            # learn of; damage is only counted.
            if raw[:1] == b"P" and crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little"):
                self._bad_pose(None, str(error), now_ns)
            else:
                self.counts.damaged += 1
            return
        yield from self._pose(sample, now_ns)

    def _line(self, raw: bytes, now_ns: int) -> Iterator[Received]:
        line = parse_line(raw)
        if isinstance(line, Reason):
            if line.code == ReasonCode.NOT_A_LINE:
                self.counts.discard(len(raw))
            else:
                self.counts.damaged += line.code == ReasonCode.BAD_CHECKSUM
                # Not to a damaged echo of ours: its answer would come back damaged as well, and
                # so on.
                if raw.split(b" ", 1)[0] not in (b"OK", b"ERR", b"EVT"):
                    self._refuse(None, line)
            return
        self.counts.lines += 1
        if line.verb in _OURS:
            self.counts.echoes += 1
        elif self._session.crc_required and not line.checked:
            self.counts.damaged += 1
            text = "found no checksum, expected one, because HELLO asked for checksums"
            self._refuse(None, Reason(ReasonCode.BAD_CHECKSUM, text))
        elif line.verb == "POSE":
            try:
                sample = parse_pose(line)
            except DecodeError as error:
                self._bad_pose(line.seq, str(error), now_ns)
            else:
                yield from self._pose(sample, now_ns)
        elif line.verb == "HELLO":
            yield from self._hello(line)
        elif line.verb == "HELP":
            found = help_text(line)
            self.counts.refused += isinstance(found, Reason)
            self._send(answer_text(line.seq, found))
        else:
            yield from self._command(line, now_ns)

    def _pose(self, sample: PoseSample, now_ns: int) -> Iterator[Received]:
        missing = self._poses.missing_before(sample.seq)
        if missing is None:
            self.counts.poses_repeated += 1
            return
        self.counts.poses += 1
        self.counts.poses_lost += missing
        yield PoseArrived(sample, now_ns, missing)

    def _bad_pose(self, seq: int | None, text: str, now_ns: int) -> None:
        """Report a bad pose at most once a second: poses get no answer,
        but developers must learn what is wrong.
        """
        self.counts.poses_bad += 1
        answered_ns = self._bad_pose_answered_ns
        if answered_ns is None or now_ns - answered_ns >= BAD_POSE_PERIOD_NS:
            self._bad_pose_answered_ns = now_ns
            self._refuse(seq, Reason(ReasonCode.BAD_ARGUMENTS, f"POSE: {text}"))

    def _hello(self, line: Line) -> Iterator[Received]:
        hello = parse_hello(line)
        if isinstance(hello, Reason):
            self._refuse(line.seq, hello)
            return
        boot, crc_required = hello
        # Otherwise a repeated HELLO: the numbers stay known.
        if not boot or boot != self._session.boot:
            self._session = _Session(boot, replies=ReplyCache(line.seq))
            self._poses = PoseSequence()
            yield Greeted(boot)
        # A repeated HELLO may change only this.
        self._session.crc_required = crc_required
        crc = "req" if crc_required else "opt"
        self._send(answer_text(line.seq, f"tacshade {PROTOCOL_VERSION} crc={crc} mode={self.mode}"))

    def _command(self, line: Line, now_ns: int) -> Iterator[Received]:
        command = parse_command(line, now_ns)
        if isinstance(command, Reason):
            self._refuse(line.seq, command)
            return
        admitted = self._session.replies.admit(line.text.strip(" "), command)
        if isinstance(admitted, Reason):
            self._refuse(line.seq, admitted)
        elif admitted is not None:
            self.counts.repeats += 1
            # Without a reply it is still in progress; its one answer will come to both.
            if admitted.reply is not None:
                self._send(admitted.reply)
        elif command.verb == "MODE":
            mode: Mode = "BIN" if command.args[0] == "BIN" else "ASCII"
            text = answer_text(command.seq, mode)
            self._session.replies.keep(command, text)
            self._send(text)  # still in the old mode
            # The bytes received after this line are in the new one already.
            self._framing.switch(mode)
        else:
            self.counts.commands += 1
            yield command
