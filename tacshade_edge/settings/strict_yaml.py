"""YAML without surprises: unique string keys, plain finite values, no aliases or tags, and a line for every key."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import read_regular

Key = tuple[str, ...]
_SCALARS = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str")}
_BYTES_MAX = 1 << 20
_VALUES_MAX = 10_000  # which the reader takes about a third of a second for


@dataclass(frozen=True, slots=True)
class Found:
    """Where a key stands and the text of its value."""

    line: int
    text: str


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


def read(path: Path) -> tuple[Any, dict[Key, Found]]:
    """Read a YAML file.

    Returns
    -------
    value : the document as dicts, lists and scalars
    found : where each key path stands; list indices are keys too, the whole document is ``()``

    Raises
    ------
    ConfigError
        Not readable, not YAML, or YAML outside the subset; ``FILE:LINE:`` leads the text.
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
        found: dict[Key, Found] = {}
        value = None if node is None else _value(path, loader, node, (), found)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{path}:{mark.line + 1}" if mark else str(path)
        raise ConfigError(f"{where}: not valid YAML here: {error.problem or error.context}") from error
    except yaml.YAMLError as error:  # a character that YAML forbids
        raise ConfigError(f"{path}: not valid YAML: {' '.join(str(error).split())}") from error
    except RecursionError as error:
        raise ConfigError(f"{path}: nested too deeply for a settings file") from error
    found.setdefault((), Found(1, "nothing"))
    return value, found


def _value(path: Path, loader: _Loader, node: yaml.Node, key: Key, found: dict[Key, Found]) -> Any:
    """Value of one node; fills `found` for it and everything below."""
    line = node.start_mark.line + 1
    if isinstance(node, yaml.MappingNode):
        found.setdefault(key, Found(line, "a mapping"))
        return _mapping(path, loader, node, key, found)
    if isinstance(node, yaml.SequenceNode):
        found.setdefault(key, Found(line, "a list"))
        return [_value(path, loader, item, (*key, str(i)), found) for i, item in enumerate(node.value)]
    # the source, so that an octal or a bare `yes` is shown as it was typed
    source = node.start_mark.buffer[node.start_mark.pointer : node.end_mark.pointer] if node.start_mark.buffer else ""
    text = shown(" ".join(source.split()), 60)
    found.setdefault(key, Found(line, text or "nothing"))
    if node.tag not in _SCALARS:
        raise ConfigError(f"{path}:{line}: {dotted(key)}: found {text}, expected a plain value")
    try:
        value = loader.construct_object(node)
    except ValueError as error:
        raise ConfigError(f"{path}:{line}: {dotted(key)}: found {text}, expected a plain value") from error
    if isinstance(value, float) and not math.isfinite(value):
        raise ConfigError(f"{path}:{line}: {dotted(key)}: found {text}, expected a finite number")
    return value


def _mapping(path: Path, loader: _Loader, node: yaml.MappingNode, key: Key, found: dict[Key, Found]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name_node, value_node in node.value:
        line = name_node.start_mark.line + 1
        if not isinstance(name_node, yaml.ScalarNode) or name_node.tag != "tag:yaml.org,2002:str":
            raise ConfigError(f"{path}:{line}: {dotted(key)}: found a key that is no name, expected a setting's name")
        name = name_node.value
        child = (*key, name)
        if name in values:
            first = found[child].line
            raise ConfigError(f"{path}:{line}: {dotted(child)}: found again, expected once (first on line {first})")
        values[name] = _value(path, loader, value_node, child, found)
        found[child] = Found(line, found[child].text)
    return values


def dotted(key: Key) -> str:
    """``path.to.key`` for a person."""
    return ".".join(shown(name, 60) for name in key) or "the file"
