"""Converts a YAML file's values to a struct, or names the first value that does not fit.

msgspec converts and checks. Its errors are English sentences that each of its versions may word
anew, so a walk over the struct's JSON Schema finds the mistake again, by structure alone.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import msgspec

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import did_you_mean, escaped
from tacshade_edge.settings.strict_yaml import Key, Located, YamlFile, dotted

T = TypeVar("T")
Schema = dict[str, Any]

_WORDS = {
    "array": "a list",
    "boolean": "true or false",
    "integer": "an integer",
    "null": "null",
    "number": "a number",
    "string": "a string",
}


@dataclass(frozen=True, slots=True)
class Misfit:
    """The first of a file's values that a schema does not accept.

    `value`: the one at `key`, None if it is missing; `schema`: what `key` accepts, or for an
    unknown key its mapping's.
    """

    key: Key
    kind: Literal["unknown", "missing", "wrong"]
    value: Any
    schema: Schema


def convert(file: YamlFile, kind: type[T], at: Key = ()) -> T:
    """Convert the value at a key to a struct. Raises ConfigError like `settings.load`."""
    value = file.value
    for name in at:
        value = value[name]
    if not isinstance(value, dict):
        named = f"{dotted(at)}: " if at else ""
        found = file.found[at]
        raise ConfigError(
            f"{file.path}:{found.line}: {named}found {found.text}, expected a mapping of settings"
        )
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        misfit = first_misfit(value, schema_of(kind), at)
        if misfit is None:
            # No schema can state what a struct's __post_init__ checks: its own words remain.
            raise file.error(at, escaped(str(error))) from None
        raise file.error(misfit.key, _problem(misfit, file.found)) from None


def schema_of(kind: type) -> Schema:
    """The JSON Schema of a struct, with those of the structs in it."""
    schema = msgspec.json.schema(kind)
    # msgspec puts the struct itself among its definitions.
    return {**schema["$defs"][kind.__name__], "$defs": schema["$defs"]}


def first_misfit(value: Any, schema: Schema, key: Key = ()) -> Misfit | None:
    """The first value at or below `key` that `schema` does not accept; None if it accepts all."""
    return _misfit(value, schema, key, schema["$defs"])


def expectation(schema: Schema, given: object = None) -> str:
    """A description, for a person, of the values that `schema` accepts."""
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}{did_you_mean(given, schema['enum'])}"
    if "anyOf" in schema and "discriminator" not in schema:
        return " or ".join(map(expectation, schema["anyOf"]))
    text = _WORDS.get(schema.get("type", ""), "a mapping")
    if schema.get("minItems"):
        text = f"a list of {schema['minItems']} {_WORDS[schema['items']['type']].split()[-1]}s"
    if "minimum" in schema:
        text += f" from {schema['minimum']} to {schema['maximum']}"
    if "exclusiveMinimum" in schema:
        text += f" above {schema['exclusiveMinimum']} to {schema['maximum']}"
    described = schema.get("description")
    return f"{text} ({described})" if described and "properties" not in schema else text


def _problem(misfit: Misfit, found: dict[Key, Located]) -> str:
    """``found …, expected …``."""
    if misfit.kind == "unknown":
        names = list(misfit.schema["properties"])
        near = did_you_mean(misfit.key[-1], names)
        return f"found an unknown key, expected one of {', '.join(names)}{near}"
    if misfit.kind == "missing":
        return f"found nothing, expected {expectation(misfit.schema)}"
    # The file's own text would be `a list`, where its length is what is wrong.
    is_list = isinstance(misfit.value, list)
    text = f"a list of {len(misfit.value)}" if is_list else found[misfit.key].text
    return f"found {text}, expected {expectation(misfit.schema, misfit.value)}"


def _misfit(value: Any, schema: Schema, key: Key, definitions: Schema) -> Misfit | None:
    options = [_resolved(option, definitions) for option in schema.get("anyOf", [schema])]
    if isinstance(value, dict) and "discriminator" in schema:
        # The tag comes first: without it, no option's keys are more right than another's.
        tag = schema["discriminator"]["propertyName"]
        options = [each for each in options if value.get(tag) in each["properties"][tag]["enum"]]
        if not options:
            tags = {"enum": list(schema["discriminator"]["mapping"])}
            return Misfit((*key, tag), "wrong" if tag in value else "missing", value.get(tag), tags)
    # msgspec allows a union at most one mapping without a tag and one list, so the first is the one
    # that was meant.
    for option in options:
        if isinstance(value, dict) and "properties" in option:
            return _misfit_in_mapping(value, option, key, definitions)
        if isinstance(value, list) and _is_list_of_right_length(value, option):
            return _misfit_in_list(value, option, key, definitions)
    if any(_is_accepted(value, option) for option in options):
        return None
    return Misfit(key, "wrong", value, schema)


def _misfit_in_mapping(
    value: dict[str, Any], schema: Schema, key: Key, definitions: Schema
) -> Misfit | None:
    for name, each in value.items():
        # In the file's order: a person mends it from top to bottom.
        if name not in schema["properties"]:
            return Misfit((*key, name), "unknown", each, schema)
        if misfit := _misfit(each, schema["properties"][name], (*key, name), definitions):
            return misfit
    for name in schema.get("required", ()):
        if name not in value:
            return Misfit((*key, name), "missing", None, schema["properties"][name])
    return None


def _misfit_in_list(
    value: list[Any], schema: Schema, key: Key, definitions: Schema
) -> Misfit | None:
    misfits = (
        _misfit(each, schema["items"], (*key, str(index)), definitions)
        for index, each in enumerate(value)
    )
    return next(filter(None, misfits), None)


def _resolved(schema: Schema, definitions: Schema) -> Schema:
    if "$ref" not in schema:
        return schema
    resolved: Schema = definitions[schema["$ref"].rpartition("/")[2]]
    return resolved


def _is_list_of_right_length(value: list[Any], schema: Schema) -> bool:
    if "items" not in schema:
        return False
    return bool(schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)))


def _is_accepted(value: Any, schema: Schema) -> bool:
    """Whether a plain value fits, by each keyword that msgspec writes for our types."""
    if "enum" in schema:
        return any(value == each for each in schema["enum"])
    match schema.get("type"):
        case "null":
            return value is None
        case "boolean":
            return isinstance(value, bool)
        case "string" if isinstance(value, str):
            return len(value) >= schema.get("minLength", 0) and bool(
                re.search(schema.get("pattern", ""), value)
            )
        # True is an int in Python, but `yes` is no number; 5.0 is no integer, as msgspec has it.
        case "integer" if isinstance(value, int) and not isinstance(value, bool):
            return _is_in_range(value, schema) and not value % schema.get("multipleOf", 1)
        case "number" if isinstance(value, int | float) and not isinstance(value, bool):
            return abs(value) <= sys.float_info.max and _is_in_range(value, schema)
    return False


def _is_in_range(value: float, schema: Schema) -> bool:
    if "exclusiveMinimum" in schema and value <= schema["exclusiveMinimum"]:
        return False
    return bool(schema.get("minimum", value) <= value <= schema.get("maximum", value))
