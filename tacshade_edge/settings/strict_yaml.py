"""YAML without surprises: unique string keys, plain decimal numbers, no aliases or tags, and a line for every key."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular

Key = tuple[str, ...]
_SCALARS = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str")}
_NUMBERS = {f"tag:yaml.org,2002:{name}" for name in ("int", "float")}
_DECIMAL = re.compile(r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_BYTES_MAX = 1 << 20
_VALUES_MAX = 10_000  # the reader needs about a third of a second for them


@dataclass(frozen=True, slots=True)
class Found:
    """A key's line and the text of its value; messages show the key's path below `at`."""

    line: int
    text: str
    at: Key = ()


@dataclass(frozen=True, slots=True)
class Mistake:
    """A mistake in the value of a key, ``FILE:LINE: path.to.key: found …``; the line is None if the key is missing."""

    key: Key
    text: str
    line: int | None


def refuse(mistakes: Sequence[Mistake]) -> None:
    """Raise ConfigError if there are mistakes, with all of them in the order of their lines, missing keys last."""
    if mistakes:
        texts = [m.text for m in sorted(mistakes, key=lambda m: (m.line is None, m.line))]
        raise ConfigError(texts[0], others=texts[1:])


class _WrongError(Exception):
    """Abandons a value after its mistake was recorded."""


class _Loader(yaml.SafeLoader):
    values = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise yaml.MarkedYAMLError(
                problem="an anchor or alias, expected a plain value", problem_mark=event.start_mark
            )
        self.values += 1
        if self.values > _VALUES_MAX:
            raise yaml.MarkedYAMLError(
                problem=f"more than {_VALUES_MAX} values, expected a settings file", problem_mark=event.start_mark
            )
        return super().compose_node(parent, index)


def read(path: Path) -> tuple[Any, dict[Key, Found], list[Mistake]]:
    """Read a YAML file: the document without its wrong values, the place of each key, and the values outside the
    subset.

    List indices are keys too, and the whole document is ``()``. Raises ConfigError, ``FILE:LINE: …``, if the file is
    unreadable, not YAML, or entirely outside the subset.
    """
    try:
        data = read_regular(path, _BYTES_MAX)
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{shown(path)}: {error.strerror or error}, expected a settings file") from error
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(f"{path}:{line}: found byte 0x{data[error.start]:02x}, expected UTF-8 text") from error
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        reader = _Reader(path, loader)
        value = None if node is None else reader.value(node, ())
    except _WrongError:
        refuse(reader.mistakes)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise ConfigError(f"{where}: not valid YAML here: {error.problem or error.context}") from error
    except yaml.YAMLError as error:  # a character that YAML forbids
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: found YAML that is nested too deeply, expected a settings file's YAML") from error
    reader.found.setdefault((), Found(1, "nothing"))
    return value, reader.found, reader.mistakes


class _Reader:
    """Converts nodes to values and records each one's place and mistakes."""

    def __init__(self, path: Path, loader: _Loader) -> None:
        self._path = path
        self._loader = loader
        self.found: dict[Key, Found] = {}
        self.mistakes: list[Mistake] = []

    def value(self, node: yaml.Node, key: Key) -> Any:
        """The value of a node and everything below it. Raises _WrongError."""
        line = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            self.found.setdefault(key, Found(line, "a mapping"))
            return self._mapping(node, key)
        if isinstance(node, yaml.SequenceNode):
            self.found.setdefault(key, Found(line, "a list"))
            return [self.value(item, (*key, str(i))) for i, item in enumerate(node.value)]
        # Show the source text, so that an octal or a bare `yes` appears as typed.
        mark = node.start_mark
        source = mark.buffer[mark.pointer : node.end_mark.pointer] if mark.buffer else ""
        text = shown(" ".join(source.split()), 60)
        self.found.setdefault(key, Found(line, text or "nothing"))
        if node.tag not in _SCALARS:
            raise self._wrong(line, key, f"found {text}, expected a plain value")
        try:
            value = self._loader.construct_object(node)
        except ValueError:
            raise self._wrong(line, key, f"found {text}, expected a plain value") from None
        if isinstance(node, yaml.ScalarNode) and node.style is None and _DECIMAL.fullmatch(node.value):
            value = value if isinstance(value, int) else float(node.value)  # YAML 1.1 reads 3e1 as text
        elif node.tag in _NUMBERS and not (isinstance(value, float) and not math.isfinite(value)):
            expected = "expected a plain decimal number, or quotes around text"
            raise self._wrong(line, key, f"found {text}, which YAML reads as {value}, {expected}")
        if isinstance(value, float) and not math.isfinite(value):
            raise self._wrong(line, key, f"found {text}, expected a finite number")
        return value

    def _mapping(self, node: yaml.MappingNode, key: Key) -> dict[str, Any]:
        values: dict[str, Any] = {}
        seen: dict[str, int] = {}
        for name_node, value_node in node.value:
            line = name_node.start_mark.line + 1
            if not isinstance(name_node, yaml.ScalarNode) or name_node.tag != "tag:yaml.org,2002:str":
                self._wrong(line, key, "found a key that is not text, expected a setting's name")
                continue
            name = name_node.value
            child = (*key, name)
            if name in seen:
                self._wrong(line, child, f"found again, expected once (first on line {seen[name]})")
                continue
            seen[name] = line
            with contextlib.suppress(_WrongError):
                values[name] = self.value(value_node, child)
            self.found[child] = Found(line, self.found[child].text)
        return values

    def _wrong(self, line: int, key: Key, problem: str) -> _WrongError:
        """Record a mistake and return the exception to raise."""
        self.mistakes.append(Mistake(key, f"{self._path}:{line}: {dotted(key)}: {problem}", line))
        return _WrongError()


def dotted(key: Key) -> str:
    """``path.to.key`` for a person."""
    return ".".join(shown(name, 60) for name in key) or "the file"
