"""The verbs of the robot's line: their arguments and what each starts, and the texts of ``OK``,
``ERR`` and ``EVT`` lines.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

from tacshade_edge.errors import DecodeError
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.clock_sync import SyncState
from tacshade_edge.robot.framing import LinkCounts
from tacshade_edge.robot.line import Line, printable, seal
from tacshade_edge.robot.pose import T_NS_MAX, parse_time
from tacshade_edge.types import QUANTITIES
from tacshade_edge.wire.error_words import OTHERWISE, error_word
from tacshade_edge.wire.requests import Request
from tacshade_edge.wire.results import ClockRead, CommandResult, LineStatus

PROTOCOL_VERSION: Final = 1
NAMES_MAX: Final = 6
RATE_DEFAULT_HZ: Final = 60
RATE_MAX_HZ: Final = 1000
SHARE: Final = 0.9
"""Share of the line's capacity for touch events;
the rest stays free for answers and other events.
"""
_BITS_PER_BYTE: Final = 10  # with start and stop bit
_BINARY_MORE: Final = 2  # an L, a byte of COBS and the zero, in place of the LF
_VALUE_BYTES_MAX: Final = 8
# A robot has 32 bits for a frame's number, as a message's header has.
_SEQ_MAX: Final = 2**32 - 1
_FRAME: Final = "frame"
UNKNOWN: Final = "-"
"""An unknown value."""
_THREE_DECIMALS: Final = ("depth_mm", "disagreement_mm")
_STITCH_ACTIONS: Final = ("BEGIN", "ADD", "END", "ABORT", "STATUS")
_BOOT = re.compile(r"boot=([0-9A-Za-z]{1,16})")


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """A command that must be executed and answered once; two are never equal.

    Its arguments are valid.

    `arrived_ns` is the time given to `SerialLink.receive`.
    """

    seq: int | None
    verb: str
    args: tuple[str, ...]
    arrived_ns: int


@dataclass(frozen=True, slots=True)
class TouchAsked:
    """The arguments of ``TOUCH ON``: some of `types.QUANTITIES`,
    and the greatest number of events per second.
    """

    names: tuple[str, ...]
    rate_hz: int


@dataclass(frozen=True, slots=True)
class TouchSeen:
    """The touch in the frame `seq`: each requested quantity, in the unit of its name,
    None if unknown.
    """

    seq: int
    t_ns: int
    contact: bool  # False once, when the contact ends, and where only a learnt model sees a touch
    values: tuple[tuple[str, float | None], ...]
    touched: bool = False  # something touches, but its depth is unknown; `contact` is then False
    valid: bool = True  # False: nobody knows what touches, since no frame can be used

    def text(self) -> str:
        """The event that reports it: ``invalid=1`` if no frame can be used, ``touched=1`` for an
        unknown depth, else ``contact=0`` without contact.
        """
        state = " touched=1" if self.touched else "" if self.contact else " contact=0"
        if not self.valid:
            state = " invalid=1"
        return f"TOUCH {self.seq & _SEQ_MAX} {self.t_ns}{state}" + "".join(
            f" {name}={_value_text(v)}" for name, v in self.values
        )


def object_text(seq: int, t_ns: int, name: str, probability: float) -> str:
    """The event that names an object."""
    return f"OBJECT {seq & _SEQ_MAX} {t_ns} {name} {probability:.3f}"


# -- the arguments ---------------------------------------------------------------------------------


def parse_touch(args: Sequence[str]) -> TouchAsked | None:
    """Parse the arguments of ``TOUCH``; None is ``OFF``. Raises DecodeError."""
    action, *names = args or ("",)
    if action.upper() == "OFF" and not names:
        return None
    if action.upper() != "ON":
        raise DecodeError(f"found {' '.join(args)[:40]!r}, expected ON or OFF")
    rate_hz = RATE_DEFAULT_HZ
    if names and names[-1][0].isdigit():
        text = names.pop()
        if not text.isdigit() or not 1 <= int(text) <= RATE_MAX_HZ:
            raise DecodeError(
                f"found the RATE {text[:16]}, expected a whole number of Hz from 1 to {RATE_MAX_HZ}"
            )
        rate_hz = int(text)
    unknown = next((name for name in names if name not in QUANTITIES), None)
    if unknown is not None:
        raise DecodeError(f"found {unknown[:20]!r}, expected one of {' '.join(QUANTITIES)}")
    if not 1 <= len(set(names)) == len(names) <= NAMES_MAX:
        raise DecodeError(f"found {len(names)} names, expected 1 to {NAMES_MAX} different names")
    return TouchAsked(tuple(names), rate_hz)


# -- what they start -------------------------------------------------------------------------------


class Desk(Protocol):
    """What a verb may ask of the daemon. Who answers later does so once."""

    def now_ns(self) -> int:
        """The daemon's clock."""

    def sensor_state(self) -> dict[str, Any]:
        """The source's state and the latest ``health``."""

    def sync_state(self) -> SyncState:
        """What is known of the robot's clock."""

    def exchanged(self, t1_ns: int, t2_ns: int, t3_ns: int, t4_ns: int | None) -> None:
        """Note a ``SYNC`` and its answer."""

    def switch_touch(self, asked: TouchAsked | None) -> CommandResult | Reason:
        """Start or stop the touch events."""

    def capture(self, command: Command) -> None:
        """Answer with the first frame taken after the command arrived."""

    def request(self, request: Request, command: Command) -> None:
        """Answer with the outcome of a request."""

    def stitch_asked(self, action: str, name: str, command: Command) -> Reason | None:
        """Answer with the outcome of a session's command, unless there are no sessions."""


def _sync(command: Command, desk: Desk, _: LinkCounts) -> CommandResult:
    # Answered in this thread, at once: what passes between the two readings of the clock is part of
    # the round trip, and so of the error of every pose's time.
    t1_ns, *rest = map(int, command.args)
    t3_ns = desk.now_ns()
    desk.exchanged(t1_ns, command.arrived_ns, t3_ns, rest[0] if rest else None)
    return ClockRead(command.arrived_ns, t3_ns)


def _status(_: Command, desk: Desk, counts: LinkCounts) -> CommandResult:
    state, sync = desk.sensor_state(), desk.sync_state()
    return LineStatus(
        camera=state["source"],
        fps=state["health"].get("delivered_fps", 0),
        sync=sync.mode,
        error_us=sync.error_us,
        drift_ppm=sync.drift_ppm,
        poses=counts.poses,
        lost=counts.poses_lost,
        damaged=counts.damaged,
        garbage=counts.garbage,
    )


def _stitch(command: Command, desk: Desk, _: LinkCounts) -> Reason | None:
    action, *name = command.args
    return desk.stitch_asked(action, name[0] if name else "", command)


@dataclass(frozen=True, slots=True)
class SerialVerb:
    """A verb's arguments as ``HELP`` shows them, how many there may be,
    and what raises DecodeError for wrong ones.

    If there are `words`, the first argument is one of them, in any case. `start` carries it out,
    and returns its answer unless that comes later; without it, the verb is for the link itself. A
    verb that `needs_calibration` is refused without one.
    """

    usage: str = ""
    least: int = 0
    most: int = 0
    words: tuple[str, ...] = ()
    check: Callable[[Sequence[str]], object] = len
    start: Callable[[Command, Desk, LinkCounts], CommandResult | Reason | None] | None = None
    needs_calibration: bool = True


VERBS: Final[dict[str, SerialVerb]] = {
    "HELLO": SerialVerb("1 [crc=req|opt] [boot=ID]"),
    # Clock and poses are ready when a calibration appears.
    "SYNC": SerialVerb(
        "t1 [t4]",
        1,
        2,
        check=lambda args: [parse_time(text) for text in args],
        start=_sync,
        needs_calibration=False,
    ),
    "POSE": SerialVerb("t x y z qw qx qy qz"),
    "CAPTURE": SerialVerb(start=lambda command, desk, _: desk.capture(command)),
    "REFERENCE": SerialVerb(
        start=lambda command, desk, _: desk.request(Request("reference"), command)
    ),
    "STITCH": SerialVerb(
        f"{'|'.join(_STITCH_ACTIONS)} [NAME]", 1, 2, words=_STITCH_ACTIONS, start=_stitch
    ),
    "TOUCH": SerialVerb(
        f"OFF|ON NAME... [RATE], 1 to {NAMES_MAX} of {' '.join(QUANTITIES)}",
        1,
        NAMES_MAX + 2,
        check=parse_touch,
        start=lambda command, desk, _: desk.switch_touch(parse_touch(command.args)),
    ),
    "STATUS": SerialVerb(start=_status, needs_calibration=False),
    "MODE": SerialVerb("BIN|ASCII", 1, 1, words=("BIN", "ASCII")),
    "HELP": SerialVerb("[VERB]"),
}
USAGE: Final = {name: f"{name} {verb.usage}".strip() for name, verb in VERBS.items()}


def parse_command(line: Line, arrived_ns: int) -> Command | Reason:
    """Parse a line that takes a number, or return why it is not valid."""
    verb, args = VERBS.get(line.verb), line.args
    if verb is None:
        return _unknown_verb(line.verb)
    if verb.words:
        args = tuple(arg.upper() for arg in args[:1]) + args[1:]
    if not verb.least <= len(args) <= verb.most or (verb.words and args[0] not in verb.words):
        return Reason(ReasonCode.BAD_ARGUMENTS, f"expected {USAGE[line.verb]}")
    try:
        verb.check(args)
    except DecodeError as error:
        return Reason(ReasonCode.BAD_ARGUMENTS, str(error))
    return Command(line.seq, line.verb, args, arrived_ns)


def parse_hello(line: Line) -> tuple[str, bool] | Reason:
    """The boot's ID, empty if ``HELLO`` names none, and whether it requires checksums,
    or why it is not valid.
    """
    version, *options = line.args or ("",)
    if version != str(PROTOCOL_VERSION):
        return Reason(
            ReasonCode.OTHER_VERSION, f"found {version or 'none'}, expected {PROTOCOL_VERSION}"
        )
    boot, crc = "", "crc=opt"
    for option in options:
        if named := _BOOT.fullmatch(option):
            boot = named[1]
        elif option in ("crc=req", "crc=opt"):
            crc = option
        else:
            return Reason(ReasonCode.BAD_ARGUMENTS, f"found {option}, expected {USAGE['HELLO']}")
    return boot, crc == "crc=req"


def help_text(line: Line) -> str | Reason:
    """The verbs, or the arguments of the verb that ``HELP`` names."""
    if not line.args:
        return f"{' '.join(USAGE)}; HELP VERB says more"
    return USAGE.get(line.args[0].upper()) or _unknown_verb(line.args[0])


def _unknown_verb(verb: str) -> Reason:
    return Reason(ReasonCode.UNKNOWN_VERB, f"found {verb[:32]}, expected one of {' '.join(USAGE)}")


# -- the texts -------------------------------------------------------------------------------------


def answer_text(seq: int | None, outcome: CommandResult | Reason | str, verb: str = "") -> str:
    """The line that answers the command `seq`; docs/reference/serial.md describes each.

    ``-`` if it has no number.

    An ``ERR`` has its code's word, but most reasons of ``REFERENCE`` share one.
    """
    number = "-" if seq is None else str(seq)
    if isinstance(outcome, Reason):
        refused = verb == "REFERENCE" and outcome.code is not ReasonCode.NOT_CALIBRATED
        return printable(
            f"ERR {number} {OTHERWISE if refused else error_word(outcome.code)} {outcome.text}"
        )
    if isinstance(outcome, ClockRead):
        outcome = f"{outcome.t2_ns} {outcome.t3_ns}"
    elif not isinstance(outcome, str):
        outcome = " ".join(
            f"{name}={_figure_text(name, value)}" for name, value in outcome.figures().items()
        )
    return printable(f"OK {number} {outcome}")


def ready_text(away_ms: int) -> str:
    """The event of a port that was opened after an absence, or 0."""
    return f"READY tacshade {PROTOCOL_VERSION}" + (f" away_ms={away_ms}" if away_ms else "")


def rate_text(found: Suspicion) -> str:
    """The event of times that pass too fast, too slowly or backwards."""
    unit = found.values.get("unit")
    # ASCII, without a blank within a value.
    seems = UNKNOWN if unit is None else str(unit).replace(" ", "").replace("µ", "u")
    rate = float(f"{found.values['rate']:.1g}")
    return f"CLOCK rate={rate:g} unit={seems} expected=ns"


def places_text(found: Suspicion) -> str:
    """The event of places that seem to be in another unit."""
    span_mm = float(f"{found.values['span_mm']:.2g}")
    return (
        f"POSE span_mm={span_mm:g} unit={str(found.values['unit']).replace('µ', 'u')} expected=mm"
    )


def _figure_text(name: str, value: object) -> object:
    if value is None:
        return UNKNOWN
    if name in _THREE_DECIMALS:
        return f"{value:.3f}"
    if name == _FRAME and isinstance(value, int):
        return value & _SEQ_MAX
    return int(value) if isinstance(value, bool) else value


def _value_text(value: float | None) -> str:
    """Format with three decimals, a large number with one;
    `UNKNOWN` if unknown or larger than any touch.
    """
    if value is None or not math.isfinite(value):
        return UNKNOWN
    texts = (f"{value:.{decimals}f}" for decimals in (3, 1))
    return next((text for text in texts if len(text) <= _VALUE_BYTES_MAX), UNKNOWN)


def unknown_quantity(asked: TouchAsked, quantities: Sequence[str] | Reason) -> Reason | None:
    """Why the calibration never gives one of the requested quantities; None if it gives all."""
    if isinstance(quantities, Reason):
        return quantities
    unknown = next((name for name in asked.names if name not in quantities), None)
    if unknown is None:
        return None
    text = (
        f"found {unknown}, which this calibration has not learnt, expected one of "
        f"{' '.join(quantities)}; calibrate --labels learns others"
    )
    return Reason(ReasonCode.UNAVAILABLE, text)


def too_slow(asked: TouchAsked, baud: int) -> Reason | None:
    """Why a line of `baud` bits/s cannot carry the events at their longest; None if it can."""
    longest_bytes, most_bytes_s = event_bytes_max(asked.names), SHARE * baud / _BITS_PER_BYTE
    if asked.rate_hz * longest_bytes <= most_bytes_s:
        return None
    found = (
        f"found {asked.rate_hz * longest_bytes} bytes/s ({asked.rate_hz} events/s of up to "
        f"{longest_bytes} bytes)"
    )
    expected = f"expected at most {most_bytes_s:.0f} bytes/s ({100 * SHARE:g} % of {baud} baud)"
    text = f"{found}, {expected}; use a lower RATE, fewer names or a faster line"
    return Reason(ReasonCode.LINE_TOO_SLOW, text)


def event_bytes_max(names: Sequence[str]) -> int:
    """The greatest length in bytes of an event of these quantities, with its checksum,
    in either mode.
    """
    # The longest state is that of an end, the longest values are those of a touch.
    ends, touches = (
        len(
            seal(
                "EVT "
                + TouchSeen(
                    _SEQ_MAX, T_NS_MAX, contact, tuple((name, None) for name in names)
                ).text()
            )
        )
        for contact in (False, True)
    )
    return max(ends, touches + len(names) * (_VALUE_BYTES_MAX - 1)) + _BINARY_MORE
