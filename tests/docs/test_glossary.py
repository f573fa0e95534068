"""The glossary's words: what a word replaced stands nowhere any more."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ROOMS = ("tacshade_edge", "docs", "tools", "config", "systemd")
SUFFIXES = {".py", ".js", ".html", ".css", ".md", ".yaml", ".json", ".toml", ".conf", ".service"}
REPLACED = {
    "displacement": "shear",
    "before_s": "pre-roll",
    "before_dropped": "pre-roll",
    "keep_before": "pre-roll",
    "foreign": "untrusted",
    "capture_to_offer": "latency",
    "Eyes": "contact detector",
    "find_stand": "locating the sensor",
    "TellingFinger": "finger reporter",
    "FramesHeard": "frame assembler",
    "Holder": "client-id guard",
    "Outlet": "topic slot",
    "whole_files": "atomic files",
    "making_again": "recalibration",
    "whole.js": "hand view",
}
"""A word that stands in no file any more, and the glossary's word in its place."""
MECHANICS = {"displacement": ("drag.py", "model.py", "skin.py")}
"""Where a word has its general meaning: files of `simulator`."""
ALLOWED = {
    # Old names of settings, which are refused with the new ones.
    "tacshade_edge/settings/model.py": ("displacement", "before_s"),
    # Tensors of the shipped networks are called so in the files: fitted weights are checked against those bytes.
    "tacshade_edge/fitting/torch_network.py": ("foreign",),
    "tools/training/export.py": ("displacement", "foreign"),
    "tools/training/integer_graph.py": ("displacement", "foreign"),
    "tools/training/network.py": ("foreign",),
    # An option of mmdebstrap, and the program that a page was made with.
    "tools/rig/arm64.py": ("foreign",),
    **{f"tacshade_edge/simulator/{file}": (word,) for word, files in MECHANICS.items() for file in files},
}


def pattern(word: str) -> re.Pattern[str]:
    """A name stands alone; a plain word also within a name, in snake case or camel case, and in the plural."""
    if not word.islower() or not word.isalpha():
        return re.compile(rf"(?<!\w){re.escape(word)}(?!\w)")
    capital = word.capitalize()
    return re.compile(rf"(?:(?<![A-Za-z])(?:{word}|{capital}|{word.upper()})|(?<=[a-z]){capital})s?(?![a-z])")


@cache
def texts() -> dict[str, str]:
    files = [ROOT / "README.md", *(path for room in ROOMS for path in (ROOT / room).rglob("*"))]
    return {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for path in files
        if path.suffix in SUFFIXES and "vendor" not in path.parts
    }


def found(word: str, in_texts: dict[str, str]) -> list[str]:
    """Where it stands though the glossary has another word for it."""
    sought = pattern(word)
    return [
        f"{name}:{text.count(chr(10), 0, match.start()) + 1}"
        for name, text in in_texts.items()
        if word not in ALLOWED.get(name, ())
        for match in sought.finditer(f"{text}")
    ]


@pytest.mark.parametrize("word", REPLACED)
def test_a_replaced_word_is_gone(word: str) -> None:
    assert found(word, texts()) == []


def test_no_file_is_called_by_a_replaced_word() -> None:
    names = {name: name for name in texts()}
    assert {word: there for word in REPLACED if (there := found(word, names))} == {}


def test_what_is_allowed_is_there() -> None:
    """An exception that nothing needs is one too many."""
    assert [
        (name, word) for name, words in ALLOWED.items() for word in words if not pattern(word).search(texts()[name])
    ] == []


@pytest.mark.parametrize(
    ("word", "text"),
    [
        ("displacement", "a DisplacementNetwork"),
        ("displacement", "read_displacement(x)"),
        ("displacement", "Displacements of the skin"),
        ("foreign", "FOREIGN_ROW = 1"),
        ("foreign", "isForeign()"),
        ("before_s", "recorder: {before_s: 3}"),
        ("FramesHeard", "from x import FramesHeard"),
    ],
)
def test_a_word_that_comes_back_is_found(word: str, text: str) -> None:
    assert found(word, {"docs/x.md": f"fine\n{text}\n"}) == ["docs/x.md:2"]


def test_the_bridges_speak_of_sensors() -> None:
    """A hand has several sensors, and no bridge knows of one."""
    bridges = {name: text for name, text in texts().items() if name.startswith("tacshade_edge/bridge/")}
    assert len(bridges) > 5
    assert [name for name, text in bridges.items() if pattern("hand").search(text)] == []


def test_nothing_in_the_package_tells() -> None:
    """Programs report, say, show, state; `stream.tell()` is Python's."""
    sought = re.compile(r"(?i)(?<![a-z])(?:tell|tells|told|telling)(?![a-z])(?!\(\))")
    package = {name: text for name, text in texts().items() if name.startswith("tacshade_edge/")}
    assert [name for name, text in package.items() if sought.search(text)] == []
