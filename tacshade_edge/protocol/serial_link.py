"""The robot's serial channel without its port: bytes in, commands and poses out; replies in, bytes out.

A link outlives its port: a robot whose cable is plugged in again goes on where it was. What is received decides
what is said; no clock, no waiting.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from typing import Final, Literal

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol import cobs
from tacshade_edge.protocol.serial_line import (
    LINE_BYTES_MAX,
    SEQ_MODULO,
    BadLine,
    Line,
    PoseSample,
    crc16,
    decode_pose,
    parse_line,
    parse_pose,
    parse_time,
    seal,
)

PROTOCOL_VERSION: Final = 1
REPLIES_KEPT: Final = 64
FRAME_BYTES_MAX: Final = LINE_BYTES_MAX + 3  # COBS of "L" and the longest line
BAD_POSE_PERIOD_NS: Final = 1_000_000_000
POSES_BEHIND: Final = 64  # a pose with so old a number comes again; one with an older begins to count anew
_POSE_FRAME_BYTES = 42  # COBS of a pose, without its zero

Mode = Literal["ASCII", "BIN"]
Handed = Literal["SYNC", "CAPTURE", "REFERENCE", "STITCH", "STATUS"]
STITCH_ACTIONS: Final = ("BEGIN", "ADD", "END", "ABORT", "STATUS")
USAGE: Final = {
    "HELLO": "HELLO 1 [crc=req|opt] [boot=ID]",
    "SYNC": "SYNC t1 [t4]",
    "POSE": "POSE t x y z qw qx qy qz",
    "CAPTURE": "CAPTURE",
    "REFERENCE": "REFERENCE",
    "STITCH": f"STITCH {'|'.join(STITCH_ACTIONS)} [NAME]",
    "STATUS": "STATUS",
    "MODE": "MODE BIN|ASCII",
    "HELP": "HELP [VERB]",
}
_ARGS: Final[dict[Handed, tuple[int, int]]] = {
    "SYNC": (1, 2),
    "CAPTURE": (0, 0),
    "REFERENCE": (0, 0),
    "STITCH": (1, 2),
    "STATUS": (0, 0),
}
_OURS: Final = frozenset({"OK", "ERR", "EVT"})  # an echo; to answer it would never end
_LINE_END = re.compile(rb"[\r\n]")
# Among frames, but not in one: there an L comes before the line.
_HELLO = re.compile(rb"((?:(?<!L)#\d{1,5} +|(?<![L ]))HELLO 1[ -~]*)[\r\n]")
_BOOT = re.compile(r"boot=([0-9A-Za-z]{1,16})")


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """A line that somebody has to do and to answer, once; two are never equal.

    Attributes
    ----------
    seq : int or None
    verb : str
        SYNC, CAPTURE, REFERENCE, STITCH or STATUS; the number of arguments is right.
    args : tuple of str
    arrived_ns : int
        As given to `SerialLink.receive`.
    """

    seq: int | None
    verb: Handed
    args: tuple[str, ...]
    arrived_ns: int


@dataclass(frozen=True, slots=True)
class PoseArrived:
    """A pose, when it arrived, and how many before it are missing by number."""

    sample: PoseSample
    arrived_ns: int
    lost: int


@dataclass(frozen=True, slots=True)
class Greeted:
    """A robot began anew: what is known of its clock and its numbers is void. `boot` is empty where it gave none."""

    boot: str


Event = Command | PoseArrived | Greeted


@dataclass(slots=True)
class LinkCounts:
    """What came in, since the start. Every numbered pose between two that arrived is in `poses` or `poses_lost`."""

    bytes: int = 0
    lines: int = 0
    commands: int = 0  # handed out, each once
    repeats: int = 0  # answered from the cache, or still being done
    refused: int = 0  # answered with ERR before they were handed out
    echoes: int = 0  # our own lines come back
    poses: int = 0
    poses_lost: int = 0  # by their numbers
    poses_repeated: int = 0
    poses_bad: int = 0  # undamaged, and no pose
    damaged: int = 0  # lines and frames with a wrong checksum
    garbage: int = 0  # stretches of bytes that are no line and no frame
    garbage_bytes: int = 0

    def as_dict(self) -> dict[str, int]:
        """For ``health``."""
        return {f.name: getattr(self, f.name) for f in fields(self)}


@dataclass(slots=True)
class _Entry:
    text: str
    command: Command | None
    reply: str | None = None  # None while it is being done


@dataclass(slots=True)
class _Session:
    """From one HELLO to the next."""

    boot: str = ""
    crc_required: bool = False
    newest: int | None = None
    replies: dict[int, _Entry] = field(default_factory=dict)


class SerialLink:
    """One robot's channel.

    Attributes
    ----------
    counts : LinkCounts
    mode : str
        ``ASCII`` or ``BIN``.
    """

    def __init__(self) -> None:
        self.counts = LinkCounts()
        self.mode: Mode = "ASCII"
        self._session = _Session()
        self._in = b""
        self._skipping = False  # until the next end of a line or frame
        self._since_zero = b""  # in ASCII: what may turn out to be a binary pose
        self._out = bytearray()
        self._pose_seq: int | None = None
        self._bad_pose_told_ns: int | None = None

    def receive(self, data: bytes, now_ns: int) -> list[Event]:
        """Understand the next bytes, however they are cut.

        Parameters
        ----------
        data : bytes
        now_ns : int
            When they arrived.

        Returns
        -------
        What somebody else must do, in order; each `Command` wants one `reply` or `refuse`, now or later.
        """
        self.counts.bytes += len(data)
        if self.mode == "ASCII":
            self._since_zero += data
        self._in += data
        events = [*self._units(now_ns)]
        if self.mode == "ASCII" and self._is_binary():
            events += self._units(now_ns)
        return events

    def reply(self, command: Command, text: str = "") -> None:
        """Answer ``OK``. A command of a session that is over is not answered: its number may mean another now."""
        self._answer(command, "OK", text)

    def refuse(self, command: Command, code: str, text: str) -> None:
        """Answer ``ERR code text``."""
        self._answer(command, "ERR", f"{code} {text}")

    def event(self, text: str) -> None:
        """Say ``EVT text``, unasked."""
        self._say(f"EVT {text}")

    def take_output(self) -> bytes:
        """What to write to the port, once."""
        out = bytes(self._out)
        self._out.clear()
        return out

    def interrupted(self) -> None:
        """The port was lost: half a line is none. All else goes on."""
        self._discard(len(self._in))
        self._in = self._since_zero = b""
        self._skipping = False
        self._out.clear()

    # From bytes to lines and frames.

    def _units(self, now_ns: int) -> Iterator[Event]:
        while (unit := self._next_unit()) is not None:
            raw, as_line = unit
            yield from self._line(raw, now_ns) if as_line else self._frame(raw, now_ns)

    def _next_unit(self) -> tuple[bytes, bool] | None:
        """The next whole line (True) or frame (False) of the buffer."""
        if self.mode == "BIN":
            return self._next_frame()
        while (end := _LINE_END.search(self._in)) is not None:
            raw, self._in = self._in[: end.start()], self._in[end.end() :]
            if self._skipping:
                self._skipping = False
                self.counts.garbage_bytes += len(raw)
            elif raw:
                return raw, True
        if len(self._in) >= LINE_BYTES_MAX:
            self._skip()
            self._in = b""
        return None

    def _next_frame(self) -> tuple[bytes, bool] | None:
        while True:
            raw, zero, rest = self._in.partition(b"\0")
            # A robot that began anew speaks ASCII. Frames look so by a chance of 2^-56 a byte.
            if b"HELLO 1" in raw and (hello := _HELLO.search(raw)):
                self._discard(hello.start())
                self.mode, self._skipping = "ASCII", False
                self._in, self._since_zero = self._in[hello.end() :], b""
                return hello[1], True
            if not zero:
                if len(raw) > FRAME_BYTES_MAX:
                    self._skip(keep=LINE_BYTES_MAX)
                return None
            self._in = rest
            if self._skipping:
                self._skipping = False
                self.counts.garbage_bytes += len(raw)
            elif raw:
                return raw, False

    def _skip(self, keep: int = 0) -> None:
        """Give up what is too long, to its end; `keep` bytes stay to be looked at."""
        if not self._skipping:
            self.counts.garbage += 1
        self._skipping = True
        self.counts.garbage_bytes += len(self._in) - keep
        self._in = self._in[len(self._in) - keep :]

    def _is_binary(self) -> bool:
        """A robot that was told MODE BIN by a daemon before this one: a whole binary pose proves it."""
        *frames, tail = self._since_zero.split(b"\0")
        self._since_zero = tail[-(_POSE_FRAME_BYTES + 1) :]
        for at, frame in enumerate(frames):
            if len(frame) == _POSE_FRAME_BYTES and _is_pose(frame):
                self._discard(len(self._in))
                self.mode, self._skipping = "BIN", False
                self._in, self._since_zero = b"\0".join([*frames[at:], tail]), b""
                return True
        return False

    def _discard(self, length: int) -> None:
        if length:
            self.counts.garbage += 1
            self.counts.garbage_bytes += length

    # From lines and frames to events.

    def _frame(self, frame: bytes, now_ns: int) -> Iterator[Event]:
        try:
            raw = cobs.decode(frame)
        except DecodeError:
            self._discard(len(frame))
            return
        if raw[:1] == b"L":
            yield from self._line(raw[1:].rstrip(b"\r\n"), now_ns)
            return
        try:
            sample = decode_pose(raw)
        except DecodeError as error:
            if raw[:1] == b"P" and _sound(raw):
                self._bad_pose(None, str(error), now_ns)
            else:
                self.counts.damaged += 1
            return
        yield from self._pose(sample, now_ns)

    def _line(self, raw: bytes, now_ns: int) -> Iterator[Event]:
        line = parse_line(raw)
        if isinstance(line, BadLine):
            if line.code == "GARBAGE":
                self._discard(len(raw))
            else:
                self.counts.damaged += line.code == "CRC"
                if raw.split(b" ", 1)[0] not in (b"OK", b"ERR", b"EVT"):
                    self._refuse_line(None, line.code, line.why)
            return
        self.counts.lines += 1
        if line.verb in _OURS:
            self.counts.echoes += 1
        elif self._session.crc_required and not line.checked:
            self.counts.damaged += 1
            self._refuse_line(None, "CRC", "found none, expected one since HELLO asked for it")
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

    def _pose(self, sample: PoseSample, now_ns: int) -> Iterator[Event]:
        lost = 0
        if sample.seq is not None:
            if self._pose_seq is not None:
                ahead = (sample.seq - self._pose_seq) % SEQ_MODULO
                if -ahead % SEQ_MODULO < POSES_BEHIND:
                    self.counts.poses_repeated += 1
                    return
                lost = ahead - 1 if ahead < SEQ_MODULO // 2 else 0
            self._pose_seq = sample.seq
        self.counts.poses += 1
        self.counts.poses_lost += lost
        yield PoseArrived(sample, now_ns, lost)

    def _bad_pose(self, seq: int | None, why: str, now_ns: int) -> None:
        """Poses are not answered; a developer still learns what is wrong, once a second."""
        self.counts.poses_bad += 1
        told_ns = self._bad_pose_told_ns
        if told_ns is None or now_ns - told_ns >= BAD_POSE_PERIOD_NS:
            self._bad_pose_told_ns = now_ns
            self._refuse_line(seq, "ARGS", f"POSE: {why}")

    def _hello(self, line: Line) -> Iterator[Event]:
        version, *options = line.args or ("",)
        if version != str(PROTOCOL_VERSION):
            self._refuse_line(line.seq, "VERSION", f"found {version or 'none'}, expected {PROTOCOL_VERSION}")
            return
        boot, crc = "", "opt"
        for option in options:
            if named := _BOOT.fullmatch(option):
                boot = named[1]
            elif option in ("crc=req", "crc=opt"):
                crc = option[4:]
            else:
                self._refuse_line(line.seq, "ARGS", f"found {option}, expected {USAGE['HELLO']}")
                return
        if not boot or boot != self._session.boot:  # else it is the same HELLO again, and the numbers stay known
            self._session = _Session(boot, newest=line.seq)
            self._pose_seq = None
            yield Greeted(boot)
        self._session.crc_required = crc == "req"
        self._say(f"OK {_number(line.seq)} tacshade {PROTOCOL_VERSION} crc={crc} mode={self.mode}")

    def _help(self, line: Line) -> None:
        if not line.args:
            self._say(f"OK {_number(line.seq)} {' '.join(USAGE)}; HELP VERB tells more")
        elif usage := USAGE.get(line.args[0].upper()):
            self._say(f"OK {_number(line.seq)} {usage}")
        else:
            self._unknown(line.seq, line.args[0])

    def _command(self, line: Line, now_ns: int) -> Iterator[Event]:
        verb = next((known for known in _ARGS if known == line.verb), None)
        if verb is None and line.verb != "MODE":
            self._unknown(line.seq, line.verb)
            return
        if why := _wrong_args(line):
            self._refuse_line(line.seq, "ARGS", why)
            return
        command = None if verb is None else Command(line.seq, verb, _args(line), now_ns)
        if line.seq is not None and not self._enter(line.seq, _Entry(line.text.strip(" "), command)):
            return
        if command is None:
            self._set_mode(line)
        else:
            self.counts.commands += 1
            yield command

    def _set_mode(self, line: Line) -> None:
        mode: Mode = "BIN" if line.args[0].upper() == "BIN" else "ASCII"
        reply = f"OK {_number(line.seq)} {mode}"
        if line.seq is not None:
            self._session.replies[line.seq].reply = reply
        self._say(reply)  # still in the old mode
        if mode != self.mode:
            # All that was received after this line is in the new mode already.
            self.mode, self._since_zero = mode, b""

    # Numbers.

    def _enter(self, seq: int, entry: _Entry) -> bool:
        """Take note of a numbered line; False when it must not be done, which is then answered."""
        session = self._session
        known = session.replies.get(seq)
        if known is not None:
            if known.text != entry.text:
                self._refuse_line(seq, "REUSED", "another line had this number, expected a new one")
                return False
            self.counts.repeats += 1
            if known.reply is not None:
                self._say(known.reply)
            return False
        behind = 0 if session.newest is None else (session.newest - seq) % SEQ_MODULO
        if REPLIES_KEPT <= behind < SEQ_MODULO // 2:  # its reply may be forgotten: to do it could be a second time
            self._refuse_line(seq, "STALE", f"expected a number after #{session.newest}, or HELLO")
            return False
        if session.newest is None or behind >= SEQ_MODULO // 2:
            session.newest = seq
            for old in [s for s in session.replies if (seq - s) % SEQ_MODULO >= REPLIES_KEPT]:
                del session.replies[old]
        session.replies[seq] = entry
        return True

    def _answer(self, command: Command, word: str, text: str) -> None:
        reply = _cut(f"{word} {_number(command.seq)} {text}".rstrip(" "))
        if command.seq is not None:
            entry = self._session.replies.get(command.seq)
            if entry is None or entry.command is not command:
                return
            entry.reply = reply
        self._say(reply)

    def _refuse_line(self, seq: int | None, code: str, why: str) -> None:
        self.counts.refused += 1
        self._say(f"ERR {_number(seq)} {code} {why}")

    def _unknown(self, seq: int | None, verb: str) -> None:
        self._refuse_line(seq, "VERB", f"found {verb[:32]}, expected one of {' '.join(USAGE)}")

    def _say(self, text: str) -> None:
        line = seal(_cut(text))
        self._out += line if self.mode == "ASCII" else cobs.encode(b"L" + line[:-1]) + b"\0"


def _is_pose(frame: bytes) -> bool:
    try:
        decode_pose(cobs.decode(frame))
    except DecodeError:
        return False
    return True


def _sound(raw: bytes) -> bool:
    """Whether a frame is as it was sent."""
    return crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")


def _number(seq: int | None) -> str:
    return "-" if seq is None else str(seq)


def _cut(text: str) -> str:
    """Printable, and short enough for a line with its checksum."""
    return "".join(c if " " <= c <= "~" and c != "*" else "?" for c in text[: LINE_BYTES_MAX - 6])


def _wrong_args(line: Line) -> str:
    """What is wrong with the arguments of a command, before its number is taken; empty when nothing is."""
    if line.verb == "MODE":
        right = len(line.args) == 1 and line.args[0].upper() in ("BIN", "ASCII")
    else:
        right = any(verb == line.verb and least <= len(line.args) <= most for verb, (least, most) in _ARGS.items())
    if right and line.verb == "STITCH":
        right = line.args[0].upper() in STITCH_ACTIONS
    if right and line.verb == "SYNC":
        try:
            for text in line.args:
                parse_time(text)
        except DecodeError as error:
            return str(error)
    return "" if right else f"expected {USAGE[line.verb]}"


def _args(line: Line) -> tuple[str, ...]:
    return (line.args[0].upper(), *line.args[1:]) if line.verb == "STITCH" else line.args
