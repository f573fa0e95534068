"""The robot's serial channel without its port: bytes in, commands and poses out; answers in, bytes out.

A link outlives its port: when its cable is plugged in again, the robot continues where it was. Answers depend only on
the received bytes: there is no clock and no waiting.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.results import SerialResult
from tacshade_edge.protocol.serial import cobs
from tacshade_edge.protocol.serial.answers import (
    PROTOCOL_VERSION,
    LinkEvent,
    answer_text,
    event_text,
)
from tacshade_edge.protocol.serial.counts import LinkCounts
from tacshade_edge.protocol.serial.framing import Framing
from tacshade_edge.protocol.serial.line import Line, crc16, parse_line
from tacshade_edge.protocol.serial.modes import Mode
from tacshade_edge.protocol.serial.output import Output
from tacshade_edge.protocol.serial.pose import PoseSample, decode_pose, parse_pose
from tacshade_edge.protocol.serial.pose_sequence import PoseSequence
from tacshade_edge.protocol.serial.replies import Repeat, ReplyCache
from tacshade_edge.protocol.serial.verbs import Command, help_text, parse_command, parse_hello
from tacshade_edge.reasons import Reason, ReasonCode

BAD_POSE_PERIOD_NS: Final = 1_000_000_000
_OURS: Final = frozenset({"OK", "ERR", "EVT"})  # echoes; answering them would never end


@dataclass(frozen=True, slots=True)
class PoseArrived:
    """A pose, its time of arrival, and how many poses before it are missing by number."""

    sample: PoseSample
    arrived_ns: int
    missing: int


@dataclass(frozen=True, slots=True)
class Greeted:
    """A robot restarted: its clock and its numbers are unknown again. `boot` is empty if the robot gave none."""

    boot: str


Received = Command | PoseArrived | Greeted


@dataclass(slots=True)
class _Session:
    """The state from one HELLO to the next."""

    boot: str = ""
    crc_required: bool = False
    replies: ReplyCache = field(default_factory=ReplyCache)


class SerialLink:
    """One robot's channel.

    Attributes
    ----------
    counts : LinkCounts
    """

    def __init__(self) -> None:
        self.counts = LinkCounts()
        self._framing = Framing(self.counts)
        self._session = _Session()
        self._poses = PoseSequence()
        self._output = Output(self._framing, self.counts)
        self._bad_pose_answered_ns: int | None = None

    @property
    def mode(self) -> Mode:
        """``ASCII`` or ``BIN``."""
        return self._framing.mode

    @property
    def buffered_bytes(self) -> int:
        """Number of bytes that wait for the rest of their line or frame."""
        return self._framing.buffered_bytes

    def receive(self, data: bytes, now_ns: int) -> list[Received]:
        """Process the next bytes, however they are split.

        Parameters
        ----------
        data : bytes
        now_ns : int
            When they arrived.

        Returns
        -------
        The caller's tasks, in order; each `Command` needs one `answer`, now or later.
        """
        self.counts.bytes += len(data)
        self._framing.feed(data)
        received: list[Received] = []
        while (unit := self._framing.next_unit()) is not None:
            received += self._line(unit.raw, now_ns) if unit.is_line else self._frame(unit.raw, now_ns)
        return received

    def answer(self, command: Command, outcome: SerialResult | Reason) -> None:
        """Answer ``OK`` or ``ERR``; ignore a command of an earlier session, whose number may mean another one now."""
        text = answer_text(command.seq, outcome, command.verb)
        if command.seq is None or self._session.replies.keep(command.seq, command, text):
            self._output.send(text)

    def notify(self, event: LinkEvent) -> None:
        """Send an unsolicited ``EVT``."""
        self._output.send(event_text(event))

    def take_output(self) -> bytes:
        """Return the bytes to write to the port and forget them."""
        return self._output.take()

    def interrupted(self) -> None:
        """Discard partial input and pending output after the port was lost; keep everything else."""
        self._framing.clear()
        self._output.take()

    def _frame(self, frame: bytes, now_ns: int) -> Iterator[Received]:
        try:
            raw = cobs.decode(frame)
        except DecodeError:
            self.counts.discard(len(frame))
            return
        if raw[:1] == b"L":
            yield from self._line(raw[1:].rstrip(b"\r\n"), now_ns)
            return
        try:
            sample = decode_pose(raw)
        except DecodeError as error:
            if raw[:1] == b"P" and _undamaged(raw):
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
                if raw.split(b" ", 1)[0] not in (b"OK", b"ERR", b"EVT"):
                    self._output.refuse(None, line)
            return
        self.counts.lines += 1
        if line.verb in _OURS:
            self.counts.echoes += 1
        elif self._session.crc_required and not line.checked:
            self.counts.damaged += 1
            text = "found no checksum, expected one, because HELLO asked for checksums"
            self._output.refuse(None, Reason(ReasonCode.BAD_CHECKSUM, text))
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
            self._help(line)
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
        """Report a bad pose at most once a second: poses get no answer, but developers must learn what is wrong."""
        self.counts.poses_bad += 1
        answered_ns = self._bad_pose_answered_ns
        if answered_ns is None or now_ns - answered_ns >= BAD_POSE_PERIOD_NS:
            self._bad_pose_answered_ns = now_ns
            self._output.refuse(seq, Reason(ReasonCode.BAD_ARGUMENTS, f"POSE: {text}"))

    def _hello(self, line: Line) -> Iterator[Received]:
        hello = parse_hello(line)
        if isinstance(hello, Reason):
            self._output.refuse(line.seq, hello)
            return
        if not hello.boot or hello.boot != self._session.boot:  # otherwise a repeated HELLO: the numbers stay known
            self._session = _Session(hello.boot, replies=ReplyCache(line.seq))
            self._poses = PoseSequence()
            yield Greeted(hello.boot)
        self._session.crc_required = hello.crc_required
        crc = "req" if hello.crc_required else "opt"
        self._output.accept(line.seq, f"tacshade {PROTOCOL_VERSION} crc={crc} mode={self.mode}")

    def _help(self, line: Line) -> None:
        text = help_text(line)
        if isinstance(text, Reason):
            self._output.refuse(line.seq, text)
        else:
            self._output.accept(line.seq, text)

    def _command(self, line: Line, now_ns: int) -> Iterator[Received]:
        parsed = parse_command(line, now_ns)
        if isinstance(parsed, Reason):
            self._output.refuse(line.seq, parsed)
            return
        command = parsed if isinstance(parsed, Command) else None
        if line.seq is not None:
            repeat = self._session.replies.admit(line.seq, line.text.strip(" "), command)
            if isinstance(repeat, Reason):
                self._output.refuse(line.seq, repeat)
                return
            if isinstance(repeat, Repeat):
                self.counts.repeats += 1
                if repeat.reply is not None:
                    self._output.send(repeat.reply)
                return
        if isinstance(parsed, Command):
            self.counts.commands += 1
            yield parsed
        else:
            self._set_mode(line.seq, parsed)

    def _set_mode(self, seq: int | None, mode: Mode) -> None:
        if seq is not None:
            self._session.replies.keep(seq, None, f"OK {seq} {mode}")
        self._output.accept(seq, mode)  # still in the old mode
        self._framing.switch(mode)  # the bytes received after this line are in the new one already


def _undamaged(raw: bytes) -> bool:
    return crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")
