"""Parse and encode one line of the robot's serial channel.

A line is ``[#seq] VERB args[*CCCC]`` in printable ASCII, at most 256 bytes with its LF; CCCC is the
CRC-16/XMODEM of everything before the ``*``. docs/reference/serial.md has the whole grammar.
"""

from __future__ import annotations

import binascii
import re
from dataclasses import dataclass
from typing import Final

from tacshade_edge.reasons import Reason, ReasonCode

LINE_BYTES_MAX: Final = 256
SEQ_MODULO: Final = 1 << 16

_PRINTABLE: Final = bytes(range(ord(" "), ord("~") + 1))
_HEAD = re.compile(r"(?:#(\S*) +)?(\S+) *(.*)")


@dataclass(frozen=True, slots=True)
class Line:
    """A parsed line: its number (0 to 65535), verb in capitals and arguments,
    and whether it had a checksum.

    `text` is everything before the ``*``: two lines with the same number and text are one line,
    sent twice.
    """

    seq: int | None
    verb: str
    args: tuple[str, ...]
    text: str
    checked: bool


def crc16(data: bytes) -> int:
    """CRC-16/XMODEM: polynomial 0x1021, initial value 0, not reflected."""
    return binascii.crc_hqx(data, 0)


def seal(text: str) -> bytes:
    """Encode a line with its checksum and LF."""
    raw = text.encode("ascii")
    return b"%s*%04X\n" % (raw, crc16(raw))


def printable(text: str) -> str:
    """Convert `text` to printable ASCII and shorten it to fit on a line with its checksum."""
    # The star, the four digits and the LF need six bytes.
    return "".join(c if " " <= c <= "~" and c != "*" else "?" for c in text[: LINE_BYTES_MAX - 6])


def parse_line(raw: bytes) -> Line | Reason:
    """Parse a line without its end.

    Reasons: NOT_A_LINE (not printable, too long), BAD_CHECKSUM, BAD_SYNTAX.
    """
    if len(raw) >= LINE_BYTES_MAX or raw.translate(None, _PRINTABLE):
        return Reason(
            ReasonCode.NOT_A_LINE,
            (
                f"found an unprintable or overlong line, expected at most {LINE_BYTES_MAX - 1} "
                "printable ASCII characters"
            ),
        )
    text, star, digits = raw.decode("ascii").rpartition("*")
    if not star:
        text = digits
    elif not re.fullmatch("[0-9A-Fa-f]{4}", digits):
        return Reason(
            ReasonCode.BAD_CHECKSUM,
            f"found {digits[:16]!r} after the star, expected four hex digits",
        )
    elif int(digits, 16) != (crc := crc16(raw[: len(text)])):
        return Reason(ReasonCode.BAD_CHECKSUM, f"found {digits.upper()}, expected {crc:04X}")
    head = _HEAD.fullmatch(text.strip(" "))
    if head is None or (head[1] is None and head[2].startswith("#")):
        return Reason(
            ReasonCode.BAD_SYNTAX,
            (
                "found a line of another form, expected [#seq] VERB args, optionally followed by a "
                "star and the CRC"
            ),
        )
    seq = head[1]
    if seq is not None and not (re.fullmatch(r"\d{1,5}", seq) and int(seq) < SEQ_MODULO):
        return Reason(
            ReasonCode.BAD_SYNTAX,
            f"found #{seq[:16]}, expected # and a number from 0 to {SEQ_MODULO - 1}",
        )
    return Line(
        None if seq is None else int(seq), head[2].upper(), tuple(head[3].split()), text, bool(star)
    )
