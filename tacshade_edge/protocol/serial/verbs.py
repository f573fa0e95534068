"""Parse the verbs of the robot's line and their arguments."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final, Literal

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.serial.answers import PROTOCOL_VERSION
from tacshade_edge.protocol.serial.line import Line
from tacshade_edge.protocol.serial.modes import Mode
from tacshade_edge.protocol.serial.pose import parse_time
from tacshade_edge.protocol.serial.touch import NAMES_MAX, parse_touch
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import QUANTITIES

CommandVerb = Literal["SYNC", "CAPTURE", "REFERENCE", "STITCH", "TOUCH", "STATUS"]
STITCH_ACTIONS: Final = ("BEGIN", "ADD", "END", "ABORT", "STATUS")
USAGE: Final = {
    "HELLO": "HELLO 1 [crc=req|opt] [boot=ID]",
    "SYNC": "SYNC t1 [t4]",
    "POSE": "POSE t x y z qw qx qy qz",
    "CAPTURE": "CAPTURE",
    "REFERENCE": "REFERENCE",
    "STITCH": f"STITCH {'|'.join(STITCH_ACTIONS)} [NAME]",
    "TOUCH": f"TOUCH OFF|ON NAME... [RATE], 1 to {NAMES_MAX} of {' '.join(QUANTITIES)}",
    "STATUS": "STATUS",
    "MODE": "MODE BIN|ASCII",
    "HELP": "HELP [VERB]",
}
_ARGUMENTS: Final[dict[CommandVerb, tuple[int, int]]] = {  # the least and the most
    "SYNC": (1, 2),
    "CAPTURE": (0, 0),
    "REFERENCE": (0, 0),
    "STITCH": (1, 2),
    "TOUCH": (1, NAMES_MAX + 2),
    "STATUS": (0, 0),
}
_BOOT = re.compile(r"boot=([0-9A-Za-z]{1,16})")


@dataclass(frozen=True, slots=True, eq=False)
class Command:
    """A command that the daemon must execute and answer once; two are never equal.

    Attributes
    ----------
    seq : int or None
    verb : str
        SYNC, CAPTURE, REFERENCE, STITCH, TOUCH or STATUS; the number of arguments is right.
    args : tuple of str
    arrived_ns : int
        As given to `SerialLink.receive`.
    """

    seq: int | None
    verb: CommandVerb
    args: tuple[str, ...]
    arrived_ns: int


@dataclass(frozen=True, slots=True)
class Hello:
    """The options of ``HELLO``; `boot` is empty if not given."""

    boot: str
    crc_required: bool


def parse_command(line: Line, arrived_ns: int) -> Command | Mode | Reason:
    """Parse a line that takes a number: a command, the mode that ``MODE`` names, or why it is neither."""
    if line.verb == "MODE":
        mode = line.args[0].upper() if len(line.args) == 1 else ""
        return "BIN" if mode == "BIN" else "ASCII" if mode == "ASCII" else _usage(line.verb)
    verb = next((known for known in _ARGUMENTS if known == line.verb), None)
    if verb is None:
        return unknown_verb(line.verb)
    least, most = _ARGUMENTS[verb]
    if not least <= len(line.args) <= most:
        return _usage(verb)
    args = line.args
    if verb == "STITCH":
        args = (args[0].upper(), *args[1:])
        if args[0] not in STITCH_ACTIONS:
            return _usage(verb)
    try:
        if verb == "SYNC":
            for text in args:
                parse_time(text)
        elif verb == "TOUCH":
            parse_touch(args)
    except DecodeError as error:
        return Reason(ReasonCode.BAD_ARGUMENTS, str(error))
    return Command(line.seq, verb, args, arrived_ns)


def parse_hello(line: Line) -> Hello | Reason:
    """Parse the arguments of ``HELLO``, or return why they are not valid."""
    version, *options = line.args or ("",)
    if version != str(PROTOCOL_VERSION):
        return Reason(ReasonCode.OTHER_VERSION, f"found {version or 'none'}, expected {PROTOCOL_VERSION}")
    boot, crc = "", "crc=opt"
    for option in options:
        if named := _BOOT.fullmatch(option):
            boot = named[1]
        elif option in ("crc=req", "crc=opt"):
            crc = option
        else:
            return Reason(ReasonCode.BAD_ARGUMENTS, f"found {option}, expected {USAGE['HELLO']}")
    return Hello(boot, crc == "crc=req")


def help_text(line: Line) -> str | Reason:
    """The verbs, or the arguments of the verb that ``HELP`` names."""
    if not line.args:
        return f"{' '.join(USAGE)}; HELP VERB says more"
    return USAGE.get(line.args[0].upper()) or unknown_verb(line.args[0])


def unknown_verb(verb: str) -> Reason:
    """The reason for rejecting a line with that verb."""
    return Reason(ReasonCode.UNKNOWN_VERB, f"found {verb[:32]}, expected one of {' '.join(USAGE)}")


def _usage(verb: str) -> Reason:
    return Reason(ReasonCode.BAD_ARGUMENTS, f"expected {USAGE[verb]}")
