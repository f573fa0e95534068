"""Make text from outside fit for one line of a log or a terminal."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def quoted(text: str, chars_max: int = 60) -> str:
    """`text` in quotes, cut to `chars_max`, with unprintable characters (line ends,
    ESC) as escapes.
    """
    return repr(text if len(text) <= chars_max else text[:chars_max] + "…")


def shown(text: object, chars_max: int = 300) -> str:
    """`text` unchanged if it is printable and short, else `quoted`. For names and paths."""
    # A name from outside could hold line ends, which forge lines of a log, or escapes, which
    # command a terminal.
    plain = str(text)
    return plain if plain.isprintable() and len(plain) <= chars_max else quoted(plain, chars_max)


def encodable(name: str) -> str:
    """A file's name in which bytes that are not UTF-8 are escapes:
    no file takes them, and OpenCV's font crashes.
    """
    return name.encode(errors="backslashreplace").decode()


def escaped(text: str, chars_max: int = 1000) -> str:
    """`text` as a single line without quotes, cut to `chars_max`,
    with unprintable characters as escapes.
    """
    if len(text) > chars_max:
        text = text[:chars_max] + "…"
    return (
        text
        if text.isprintable()
        else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    )


def counted(count: int, noun: str) -> str:
    """``1 frame``, ``2 frames``, ``2 presses``, ``2 touches``."""
    if count == 1:
        return f"1 {noun}"
    return f"{count} {noun}{'es' if noun.endswith(('s', 'ch')) else 's'}"


def did_you_mean(text: object, names: Iterable[object]) -> str:
    """``; did you mean NAME?`` with the name nearest to `text`,
    or an empty string if none is near.
    """
    # A key that is missing, or typed as a number, resembles no name.
    near = (
        difflib.get_close_matches(text, list(map(str, names)), 1) if isinstance(text, str) else []
    )
    return f"; did you mean {near[0]}?" if near else ""
