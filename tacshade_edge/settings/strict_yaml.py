"""YAML without surprises: unique string keys, plain decimal numbers, no aliases or tags,
and a line for every key.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tacshade_edge.errors import ConfigError
from tacshade_edge.files.file_kinds import kind_of
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import decoded, read_regular

Key = tuple[str, ...]
_SCALARS = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str")}
_NUMBERS = {f"tag:yaml.org,2002:{name}" for name in ("int", "float")}
# Numbers as everybody reads them; YAML 1.1 also reads others as numbers.
_DECIMAL = re.compile(r"[-+]?(?:(?:0|[1-9][0-9]*)(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][-+]?[0-9]+)?")
_BYTES_MAX = 1 << 20
# The reader needs about a third of a second for these.
_VALUES_MAX = 10_000


@dataclass(frozen=True, slots=True)
class Located:
    """A key's line and the text of its value; messages show the key's path below `at`."""

    line: int
    text: str
    at: Key = ()


@dataclass(frozen=True, slots=True)
class YamlFile:
    """A file's value, and the place of each key in it:
    list indices are keys too, and the whole value is ``()``.
    """

    path: Path
    value: Any
    found: dict[Key, Located]

    def where(self, key: Key) -> str:
        """``FILE:LINE: path.to.key`` (without a line if the file does not have the key)."""
        if key in self.found:
            return f"{self.path}:{self.found[key].line}: {dotted((*self.found[key].at, *key))}"
        return f"{self.path}: {dotted((*self.found[()].at, *key) if () in self.found else key)}"

    def error(self, key: Key, problem: str) -> ConfigError:
        return ConfigError(f"{self.where(key)}: {problem}")


class _Loader(yaml.SafeLoader):
    """Converts nodes to values and records each one's place."""

    def __init__(self, path: Path, text: str) -> None:
        super().__init__(text)
        self.path = path
        self.values = 0
        self.found: dict[Key, Located] = {}

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        self.values += 1
        problem = (
            f"more than {_VALUES_MAX} values, expected a settings file"
            if self.values > _VALUES_MAX
            else None
        )
        # A few lines of nested aliases stand for billions of values.
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            problem = "an anchor or alias, expected a plain value"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return super().compose_node(parent, index)

    def value(self, node: yaml.Node, key: Key) -> Any:
        """The value of a node and everything below it. Raises ConfigError."""
        line = node.start_mark.line + 1
        if isinstance(node, yaml.MappingNode):
            self.found.setdefault(key, Located(line, "a mapping"))
            return self._mapping(node, key)
        if isinstance(node, yaml.SequenceNode):
            self.found.setdefault(key, Located(line, "a list"))
            return [self.value(item, (*key, str(i))) for i, item in enumerate(node.value)]
        # Show the source text, so that an octal or a bare `yes` appears as typed.
        mark = node.start_mark
        source = mark.buffer[mark.pointer : node.end_mark.pointer] if mark.buffer else ""
        text = shown(" ".join(source.split()), 60)
        self.found.setdefault(key, Located(line, text or "nothing"))
        try:
            # Other tags are dates and Python's objects, which no setting is.
            value = self.construct_object(node) if node.tag in _SCALARS else node
        except ValueError:
            value = node
        if value is node:
            raise self._error(line, key, f"found {text}, expected a plain value")
        is_finite = not isinstance(value, float) or math.isfinite(value)
        if (
            isinstance(node, yaml.ScalarNode)
            and node.style is None
            and _DECIMAL.fullmatch(node.value)
        ):
            # YAML 1.1 reads 3e1 as text.
            value = value if isinstance(value, int) else float(node.value)
        # YAML 1.1 has octal, binary and sexagesimal numbers: 010 is 8, and 1:30 is 90.
        elif node.tag in _NUMBERS and is_finite:
            expected = "expected a plain decimal number, or quotes around text"
            raise self._error(line, key, f"found {text}, which YAML reads as {value}, {expected}")
        if isinstance(value, float) and not math.isfinite(value):
            raise self._error(line, key, f"found {text}, expected a finite number")
        return value

    def _mapping(self, node: yaml.MappingNode, key: Key) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for name_node, value_node in node.value:
            line = name_node.start_mark.line + 1
            if (
                not isinstance(name_node, yaml.ScalarNode)
                or name_node.tag != "tag:yaml.org,2002:str"
            ):
                raise self._error(
                    line, key, "found a key that is not text, expected a setting's name"
                )
            child = (*key, name_node.value)
            # PyYAML would let the last one win without a word.
            if child in self.found:
                first = self.found[child].line
                raise self._error(
                    line, child, f"found again, expected once (first on line {first})"
                )
            values[name_node.value] = self.value(value_node, child)
            # The key's line, where people look, and not that of a value that begins below it.
            self.found[child] = Located(line, self.found[child].text)
        return values

    def _error(self, line: int, key: Key, problem: str) -> ConfigError:
        return ConfigError(f"{self.path}:{line}: {dotted(key)}: {problem}")


def read(path: Path) -> YamlFile:
    """Read a YAML file.

    Raises ConfigError, ``FILE:LINE: path.to.key: found …, expected …``, for the first mistake.
    """
    try:
        data = read_regular(path, _BYTES_MAX)
    except OSError as error:
        raise ConfigError(
            f"{shown(path)}: {error.strerror or error}, expected a settings file"
        ) from error
    return parse(path, data)


def parse(path: Path, data: bytes) -> YamlFile:
    """Parse the content of a YAML file. Raises ConfigError like `read`."""
    try:
        text = decoded(data)
    except UnicodeDecodeError as error:
        if kind := kind_of(data):
            raise ConfigError(f"{path}: found {kind}, expected a YAML file") from None
        line = data.count(b"\n", 0, error.start) + 1
        raise ConfigError(
            f"{path}:{line}: found byte 0x{data[error.start]:02x}, expected UTF-8 text"
        ) from error
    try:
        loader = _Loader(path, text)
        node = loader.get_single_node()
        value = None if node is None else loader.value(node, ())
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise ConfigError(
            f"{where}: not valid YAML here: {error.problem or error.context}"
        ) from error
    except yaml.YAMLError as error:
        # A character that YAML forbids, which has no line.
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ConfigError(
            f"{path}: found YAML that is nested too deeply, expected a settings file's YAML"
        ) from error
    # An empty file has no node, but its mistake needs a place.
    loader.found.setdefault((), Located(1, "nothing"))
    return YamlFile(path, value, loader.found)


def dotted(key: Key) -> str:
    """``path.to.key`` for a person."""
    return ".".join(shown(name, 60) for name in key) or "the file"
