"""A settings file to `Settings`, with the line of whatever is wrong."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from tacshade_edge.core.profiles import AUTO
from tacshade_edge.errors import ConfigError
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.model import Files, Settings, Simulated, Source, json_schema
from tacshade_edge.settings.strict_yaml import Found, Key, dotted

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Document:
    """A valid settings file.

    Attributes
    ----------
    path : Path
    settings : Settings
        Its paths are absolute: a relative one counts from the file's folder.
    found : dict
        Where each given key stands.
    """

    path: Path
    settings: Settings
    found: dict[Key, Found]

    def where(self, *key: str) -> str:
        """``FILE:LINE: path.to.key`` (without a line for a key that was left at its default)."""
        return _where(self.path, self.found, key)


def load(path: Path) -> Document:
    """Read and check a settings file.

    Raises
    ------
    ConfigError
        ``FILE:LINE: path.to.key: found …, expected …``.
    """
    settings, found = read_struct(path, Settings, json_schema())
    known = json_schema()["$defs"]["Settings"]["properties"]["profile"]
    if settings.profile not in known["enum"]:  # msgspec cannot express names that are known only at run time
        problem = f"found {found['profile',].text}, expected {expectation(known)}"
        raise ConfigError(f"{_where(path, found, ('profile',))}: {problem}")
    _check_budget(path, settings, found)
    return Document(path, _absolute(settings, path.absolute().parent), found)


def _check_budget(path: Path, settings: Settings, found: dict[Key, Found]) -> None:
    """A budget with `AUTO`, and with nothing else: it would have no effect."""
    key, budget_ms = ("latency_budget_ms",), settings.latency_budget_ms
    if settings.profile == AUTO and budget_ms is None:
        expected = expectation(json_schema()["$defs"]["Settings"]["properties"]["latency_budget_ms"]["anyOf"][0])
        text = found[key].text if key in found else "nothing"
        raise ConfigError(f"{_where(path, found, key)}: found {text} with profile {AUTO}, expected {expected}")
    if settings.profile != AUTO and budget_ms is not None:
        problem = f"found {found[key].text} with profile {settings.profile}, expected it with profile {AUTO} only"
        raise ConfigError(f"{_where(path, found, key)}: {problem}")


def to_yaml(settings: Settings) -> str:
    """The text of a settings file that says the same."""
    text: str = yaml.safe_dump(msgspec.to_builtins(settings), sort_keys=False, allow_unicode=True)
    return text


def read_struct(path: Path, kind: type[T], schema: dict[str, Any]) -> tuple[T, dict[Key, Found]]:
    """Read a YAML file as one msgspec struct, whose JSON Schema is `schema`.

    Raises
    ------
    ConfigError
        ``FILE:LINE: path.to.key: found …, expected …``.
    """
    value, found = strict_yaml.read(path)
    return as_struct(path, value, found, kind, schema), found


def as_struct(
    path: Path, document: Any, found: dict[Key, Found], kind: type[T], schema: dict[str, Any], at: Key = ()
) -> T:
    """Convert what stands at a key of a YAML document to a struct. Raises ConfigError as `read_struct`."""
    value = document
    for name in at:
        value = value[name]
    if not isinstance(value, dict):
        named = f"{dotted(at)}: " if at else ""
        raise ConfigError(f"{path}:{found[at].line}: {named}found {found[at].text}, expected a mapping of settings")
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        below = {key[len(at) :]: where for key, where in found.items() if key[: len(at)] == at}
        key, problem = _explain(str(error), value, below, schema)
        raise ConfigError(f"{_where(path, found, (*at, *key))}: {problem}") from error


def _where(path: Path, found: dict[Key, Found], key: Key) -> str:
    return f"{path}:{found[key].line}: {dotted(key)}" if key in found else f"{path}: {dotted(key)}"


def _absolute(settings: Settings, folder: Path) -> Settings:
    """The same settings with every relative path made absolute against `folder`."""

    def at(path: str | None) -> str | None:
        return None if path is None else str(folder / path)

    mqtt = settings.mqtt
    replace = msgspec.structs.replace
    return replace(
        settings,
        calibration=at(settings.calibration),
        source=_source_at(settings.source, folder),
        mqtt=replace(mqtt, password_file=at(mqtt.password_file), ca_file=at(mqtt.ca_file)),
        recorder=replace(settings.recorder, folder=at(settings.recorder.folder)),
        stitching=replace(settings.stitching, folder=at(settings.stitching.folder)),
    )


def _source_at(source: Source, folder: Path) -> Source:
    if isinstance(source, Files):
        return msgspec.structs.replace(source, path=str(folder / source.path))
    if isinstance(source, Simulated) and source.pressed is not None:
        return msgspec.structs.replace(source, pressed=str(folder / source.pressed))
    return source


def _explain(message: str, value: dict[str, Any], found: dict[Key, Found], root: dict[str, Any]) -> tuple[Key, str]:
    """Key and ``found …, expected …`` of one msgspec error, which names a JSON path and one field."""
    path = re.search(r" - at `\$\.?([^`]*)`$", message)
    key: Key = tuple(re.split(r"[.[]", path[1].replace("]", ""))) if path and path[1] else ()
    schema = _schema_at(key, value, root)
    if unknown := re.match(r"Object contains unknown field `(.*?)`", message, re.DOTALL):
        return (*key, unknown[1]), f"found an unknown key, expected one of {', '.join(schema['properties'])}"
    if missing := re.match(r"Object missing required field `(.*?)`", message):
        key = (*key, missing[1])
        return key, f"found nothing, expected {expectation(_schema_at(key, value, root))}"
    return key, f"found {found[key].text}, expected {expectation(schema)}"


def _schema_at(key: Key, value: Any, root: dict[str, Any]) -> dict[str, Any]:
    """JSON Schema of the value at `key`; a tagged union is resolved by the tag that `value` gives."""
    schema = _resolved(root, value, root)
    for name in key:
        if "discriminator" in schema:  # no known tag was given: the only key to name is the tag itself
            return {"enum": list(schema["discriminator"]["mapping"])}
        value = value[int(name)] if isinstance(value, list) else value.get(name)
        schema = _resolved(schema["items"] if "items" in schema else schema["properties"][name], value, root)
    return schema


def _resolved(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> dict[str, Any]:
    """`schema` with its reference followed, and the struct that the tag in `value` chooses."""
    if "anyOf" in schema and "discriminator" not in schema and isinstance(value, dict):  # a struct, or null
        schema = next((option for option in schema["anyOf"] if "$ref" in option), schema)
    reference = schema.get("$ref")
    if "discriminator" in schema and isinstance(value, dict):
        tag = value.get(schema["discriminator"]["propertyName"])
        reference = schema["discriminator"]["mapping"].get(tag) if isinstance(tag, str) else None
    return root["$defs"][reference.rpartition("/")[2]] if reference else schema


def expectation(schema: dict[str, Any]) -> str:
    """What a person should write there."""
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    if "anyOf" in schema and "discriminator" not in schema:
        options = [expectation({**option}) for option in schema["anyOf"]]
        return " or ".join(options)
    kind = {"integer": "an integer", "number": "a number", "string": "a string", "boolean": "true or false"}
    kind["array"] = "a list"
    text = kind.get(schema.get("type", ""), "null" if schema.get("type") == "null" else "a mapping")
    if "minimum" in schema:
        text += f" from {schema['minimum']} to {schema['maximum']}"
    if "exclusiveMinimum" in schema:
        text += f" above {schema['exclusiveMinimum']}" + (f" to {schema['maximum']}" if "maximum" in schema else "")
    described = schema.get("description")
    return f"{text} ({described})" if described and "properties" not in schema else text
