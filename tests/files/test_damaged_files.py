"""Files of every kind that we read, damaged: reading gives a value or one line,
and what has a checksum reports it.
"""

from __future__ import annotations

import logging
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.examples import at_most
from support.file_kinds import NAMES, Files, Kind, kinds
from tacshade_edge.errors import TacshadeError
from tacshade_edge.files import npz
from tacshade_edge.files.npz import Content

LINE_CHARS_MAX = 2000
JUNK = (
    None,
    True,
    0,
    -1,
    2**31,
    2**63,
    2**64,
    0.0,
    -0.0,
    1e-300,
    1e300,
    float("nan"),
    float("inf"),
    45.0,
    "",
    "x",
    "nan",
    "\x00",
    "\n\x1b[31m",
    "../../x",
    "a" * 5000,
    [],
    {},
    [None],
    [0.0] * 7,
    [1e300] * 7,
    {"a": 1},
)
WORDS = (
    "",
    "0",
    "-1",
    "1e300",
    "nan",
    "inf",
    "9" * 400,
    "0x10",
    "1_0",
    "null",
    "~",
    "[]",
    "{}",
    "[[[",
    "&a [*a]",
    "*a",
    "!!python/object:os.system",
    "\t",
    "\x00",
    "\x1b[2J",
    "'",
    '"',
    ",",
    ":",
    "#",
    "- -",
    "é",
    "٣",
    "[" * 100_000,
)


@st.composite
def damage(draw: st.DrawFn, content: bytes, text: bool) -> bytes:
    """Damage in one place: flipped bits, a cut, a hole, other bytes, an impossible number,
    or another word.
    """
    at = draw(st.integers(0, len(content)) | st.integers(0, min(len(content), 200)))
    size = draw(st.integers(1, 64))
    way = draw(
        st.sampled_from(("flip", "cut", "hole", "put", "zeros", "number", *("word",) * 6 * text))
    )
    rest = content[at + size :]
    if way == "word":
        words = content.replace(b",", b" , ").replace(b"\n", b" \n ").split(b" ")
        words[draw(st.integers(0, len(words) - 1))] = draw(st.sampled_from(WORDS)).encode()
        return b" ".join(words).replace(b" , ", b",").replace(b" \n ", b"\n")
    if way == "flip":
        return (
            content[:at]
            + bytes(byte ^ 1 << draw(st.integers(0, 7)) for byte in content[at : at + 1])
            + content[at + 1 :]
        )
    put = {
        "put": draw(st.binary(min_size=size, max_size=size)),
        "zeros": bytes(size),
        "number": draw(st.sampled_from((b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff"))),
    }
    return content[:at] + put.get(way, b"") + (b"" if way == "cut" else rest)


@contextmanager
def warnings_kept() -> Iterator[list[str]]:
    """Keep the log's warnings instead of writing them."""
    lines: list[str] = []
    handler, logger = logging.Handler(logging.WARNING), logging.getLogger("tacshade_edge")
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    logger.addHandler(handler)
    logger.propagate = False
    try:
        yield lines
    finally:
        logger.removeHandler(handler)
        logger.propagate = True


def read(kind: Kind, changed: Files) -> tuple[Any, list[str]]:
    """Read files as the program does; the value is None and the last line is the error
    if it refuses them.
    """
    with TemporaryDirectory(dir="/dev/shm") as name, warnings_kept() as lines:
        for path, content in (kind.files | changed).items():
            (Path(name) / path).parent.mkdir(parents=True, exist_ok=True)
            (Path(name) / path).write_bytes(content)
        try:
            return kind.read(Path(name)), lines
        except TacshadeError as error:
            return None, [*lines, str(error)]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=at_most(200))
@given(data=st.data())
def test_a_damaged_file_is_used_or_refused_in_one_line(name: str, data: st.DataObject) -> None:
    kind = kinds()[name]
    good, _ = read(kind, {})
    assert good is not None
    file = data.draw(st.sampled_from(kind.damaged or tuple(kind.files)[:1]))
    content = kind.files[file]
    for _ in range(data.draw(st.sampled_from((1, 1, 2, 5)))):
        content = data.draw(damage(content, file.endswith((".yaml", ".csv", ".json"))))
    value, lines = read(kind, {file: content})
    assert all("\n" not in line and len(line) < LINE_CHARS_MAX for line in lines)
    # Presses that are cut off between two of them are presses that were not written yet.
    begun = name == "session" and value is not None and value == good[: len(value)]
    assert value == good or lines or begun or not kind.checked


@pytest.mark.slow
@pytest.mark.parametrize("name", ["calibration", "fitted calibration", "stored reference"])
@settings(max_examples=at_most(200))
@given(data=st.data())
def test_wrong_content_behind_a_right_checksum_is_used_or_refused_in_one_line(
    name: str, data: st.DataObject
) -> None:
    kind = kinds()[name]
    ((file, packed),) = kind.files.items()
    with TemporaryDirectory() as folder:
        (Path(folder) / file).write_bytes(packed)
        content = npz.read(str(Path(folder) / file), "", "")
    meta, arrays = dict(content.meta), dict(content.arrays)
    part = data.draw(st.sampled_from(("meta", "inner", "array", "gone")))
    key = data.draw(st.sampled_from(sorted(arrays if part == "array" else meta)))
    junk = st.sampled_from(JUNK)
    if part == "array":
        shape = data.draw(st.lists(st.sampled_from((0, 1, 2, 7, 119, 120, 160)), max_size=3))
        arrays[key] = np.full(
            shape,
            data.draw(st.sampled_from((0, 1, 255))),
            data.draw(st.sampled_from(("u1", "f4", "U3"))),
        )
    elif part == "inner" and isinstance(meta[key], dict) and meta[key]:
        meta[key] = {**meta[key], data.draw(st.sampled_from(sorted(meta[key]))): data.draw(junk)}
    elif part == "gone":
        del meta[key]
    else:
        meta[key] = data.draw(junk)
    _, lines = read(kind, {file: Content(meta, arrays).packed()})
    assert all("\n" not in line and len(line) < LINE_CHARS_MAX for line in lines)


@pytest.mark.parametrize("sides", [(0, 1), (8193, 8193), (30_000, 30_000), (2**31 - 1, 2**32 - 1)])
def test_a_png_that_states_another_size_behind_a_right_checksum(sides: tuple[int, int]) -> None:
    kind = kinds()[".png"]
    ((file, content),) = kind.files.items()
    head = struct.pack(">4s2I5B", b"IHDR", *sides, 8, 0, 0, 0, 0)
    value, lines = read(
        kind, {file: content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]}
    )
    assert value is None
    assert "\n" not in lines[-1]
