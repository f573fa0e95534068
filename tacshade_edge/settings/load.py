"""Loads a settings file as `Settings` and reports the line of every mistake.

A file may have several sensors: keys outside ``sensors`` apply to all, keys in a sensor to that one. With ``hand_id``
next to ``sensors`` they are the fingers of a hand, and each has its ``hand_T_sensor``.

::

    mqtt: {host: localhost}
    profile: balanced
    sensors:
      left-thumb: {calibration: thumb.npz, source: {kind: v4l2, device: /dev/v4l/by-id/thumb}}
      left-index: {calibration: index.npz, source: {kind: v4l2, device: /dev/v4l/by-id/index}, profile: fast}
"""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from tacshade_edge.core.profiles import AUTO, DEFAULT
from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import did_you_mean, shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.model import (
    FINGER,
    HAND,
    OWN,
    RENAMED,
    SENSORS,
    Files,
    Rpicam,
    Settings,
    Simulated,
    Source,
    V4l2,
    wrong_with,
)
from tacshade_edge.settings.strict_yaml import Found, Key, Mistake, dotted

T = TypeVar("T")
_V4L2_EXPOSURE_US = 100  # V4L2_CID_EXPOSURE_ABSOLUTE
_MISTAKES_MAX = 50  # found one after another; further ones appear when these are fixed


@dataclass(frozen=True, slots=True)
class Document:
    """A valid settings file; relative paths in it are made absolute from its folder.

    `found` is the place of each given key; `several`: the file has a ``sensors`` key.
    """

    path: Path
    settings: Settings
    found: dict[Key, Found]
    several: bool = False

    def where(self, *key: str) -> str:
        """``FILE:LINE: path.to.key`` (without a line if the key has its default)."""
        return _where(self.path, self.found, key)


@dataclass(frozen=True, slots=True)
class Hand:
    """The hand that a file's sensors form; `common` are the settings outside ``sensors``: the broker, as the hand logs
    in.
    """

    common: Document
    hand_id: str
    fingers: tuple[str, ...]


def load(path: Path, sensor_id: str | None = None) -> Document:
    """Read and check a settings file and return one sensor's document; without `sensor_id` there must be only one.

    Raises ConfigError with all mistakes, ``FILE:LINE: path.to.key: found …, expected …``.
    """
    documents = load_all(path)
    if sensor_id is None and len(documents) == 1:
        return documents[0]
    for document in documents:
        if document.settings.sensor_id == sensor_id:
            return document
    ids = ", ".join(document.settings.sensor_id for document in documents)
    if sensor_id is None:
        raise ConfigError(f"{path}: found several sensors but no --sensor, expected --sensor with one of {ids}")
    raise ConfigError(f"--sensor: found {shown(sensor_id)}, expected one of {ids} ({path})")


def load_all(path: Path) -> tuple[Document, ...]:
    """Read and check a settings file with one sensor or several. Raises ConfigError like `load`."""
    value, found, mistakes = strict_yaml.read(path)
    several = isinstance(value, dict) and SENSORS in value
    parts, wrong = split(path, value, found) if several else ([(value, found)], [])
    documents = []
    for value_of_one, found_of_one in parts:
        settings, wrong_of_one = _converted(path, value_of_one, found_of_one, Settings)
        known = {m.key for m in (*mistakes, *wrong_of_one)}
        wrong_of_one += _profile_mistakes(path, value_of_one, found_of_one, known)
        wrong_of_one += _exposure_mistakes(path, found_of_one, settings)
        wrong_of_one += _hand_mistakes(path, value_of_one, found_of_one, known, several)
        wrong += [mistake for mistake in wrong_of_one if mistake not in wrong]  # report a shared key once
        if settings is not None:
            settings = _absolute(settings, path.absolute().parent)
            settings = own_folders(settings, found_of_one) if several else settings
            documents.append(Document(path, settings, found_of_one, several))
    strict_yaml.refuse(mistakes + wrong)
    return tuple(documents)


def load_hand(path: Path) -> Hand | None:
    """Read the hand that a settings file names, or None if it names none. Raises ConfigError like `load`."""
    fingers = tuple(document.settings.sensor_id for document in load_all(path))
    value, found, _ = strict_yaml.read(path)
    kept = {key: value[key] for key in (HAND, "mqtt") if value.get(key) is not None}
    settings = _absolute(msgspec.convert(kept, Settings), path.absolute().parent)
    return Hand(Document(path, settings, found, True), settings.hand_id, fingers) if settings.hand_id else None


def _hand_mistakes(
    path: Path, value: dict[str, Any], found: dict[Key, Found], known: set[Key], several: bool
) -> list[Mistake]:
    """Mistakes about hands: a finger must belong to a hand, and a hand must have several sensors."""
    hand_id, seven = value.get(HAND), value.get(FINGER)
    if hand_id is not None and not several:
        return [_mistake(path, found, (HAND,), f"found {found[HAND,].text}, expected it beside {SENSORS} only")]
    if any(key[:1] == (FINGER,) for key in known) or (seven is None and hand_id is None):
        return []
    if hand_id is None:
        return [_mistake(path, found, (FINGER,), f"found it without {HAND}, expected it in a hand's sensors only")]
    if seven is None:
        text = f"found no place, expected the sensor's place in the hand that {HAND} names"
        return [_mistake(path, found, (FINGER,), text)] if FINGER in value else []  # else `split` reported it
    problem = wrong_with(seven)
    return [_mistake(path, found, (FINGER,), problem)] if problem else []


def _exposure_mistakes(path: Path, found: dict[Key, Found], settings: Settings | None) -> list[Mistake]:
    """An exposure that does not fit into the frame period, which slows the camera down without notice."""
    source = None if settings is None else settings.source
    if isinstance(source, Rpicam):
        name, value, unit_us = "exposure_us", source.exposure_us, 1
    elif isinstance(source, V4l2) and source.exposure is not None:
        name, value, unit_us = "exposure", source.exposure, _V4L2_EXPOSURE_US
    else:
        return []
    most = (1_000_000 - 1) // (source.fps * unit_us)
    if value <= most:
        return []
    expected = f"expected at most {most}, because a frame takes {1e6 / source.fps:.0f} µs at {source.fps} frames/s"
    return [_mistake(path, found, ("source", name), f"found {value}, {expected}")]


def _profile_mistakes(path: Path, value: dict[str, Any], found: dict[Key, Found], known: set[Key]) -> list[Mistake]:
    """Mistakes that msgspec cannot find: an unknown profile, `AUTO` without a budget, a budget without `AUTO`."""
    properties, budget = schema_of(Settings)["properties"], ("latency_budget_ms",)
    profile, budget_ms = value.get("profile", DEFAULT), value.get("latency_budget_ms")
    if ("profile",) in known:
        return []
    if profile not in properties["profile"]["enum"]:
        problem = f"found {found['profile',].text}, expected {expectation(properties['profile'], profile)}"
        return [_mistake(path, found, ("profile",), problem)]
    if budget in known:
        return []
    if profile == AUTO and budget_ms is None:
        text = found[budget].text if budget in found else "nothing"
        expected = expectation(properties["latency_budget_ms"]["anyOf"][0])
        return [_mistake(path, found, budget, f"found {text} with profile {AUTO}, expected {expected}")]
    if profile != AUTO and budget_ms is not None:
        problem = f"found {found[budget].text} with profile {profile}, expected it with profile {AUTO} only"
        return [_mistake(path, found, budget, problem)]
    return []


def to_yaml(settings: Settings) -> str:
    """The text of a settings file with these settings."""
    text: str = yaml.safe_dump(msgspec.to_builtins(settings), sort_keys=False, allow_unicode=True)
    return text


def schema_of(kind: type) -> dict[str, Any]:
    """The JSON Schema of a struct, with those of the structs in it."""
    schema = msgspec.json.schema(kind)
    return {**schema["$defs"][kind.__name__], "$defs": schema["$defs"]}


def read_struct(path: Path, kind: type[T]) -> tuple[T, dict[Key, Found]]:
    """Read a YAML file as one msgspec struct. Raises ConfigError like `load`."""
    value, found, mistakes = strict_yaml.read(path)
    struct, wrong = _converted(path, value, found, kind)
    strict_yaml.refuse(mistakes + wrong)
    assert struct is not None  # else something was wrong
    return struct, found


def as_struct(path: Path, document: Any, found: dict[Key, Found], kind: type[T], at: Key = ()) -> T:
    """Convert the value at a key of a YAML document to a struct. Raises ConfigError like `read_struct`."""
    struct, wrong = _converted(path, document, found, kind, at)
    strict_yaml.refuse(wrong)
    assert struct is not None  # else something was wrong
    return struct


def _converted(
    path: Path, document: Any, found: dict[Key, Found], kind: type[T], at: Key = ()
) -> tuple[T | None, list[Mistake]]:
    """The struct, or None and all mistakes.

    msgspec stops at the first mistake, so this removes each from a copy and tries again. A mapping that lacks a
    required key is removed whole; msgspec checks for missing keys last, so no other mistake in it is overlooked.
    """
    value = document
    for name in at:
        value = value[name]
    if not isinstance(value, dict):
        named = f"{dotted(at)}: " if at else ""
        text = f"{path}:{found[at].line}: {named}found {found[at].text}, expected a mapping of settings"
        raise ConfigError(text)
    below = {key[len(at) :]: where for key, where in found.items() if key[: len(at)] == at}
    rest = copy.deepcopy(value)
    mistakes: list[Mistake] = []
    while len(mistakes) < _MISTAKES_MAX:
        try:
            struct = msgspec.convert(rest, kind)
        except msgspec.ValidationError as error:
            keys, problem, out = _explain(str(error), rest, below, schema_of(kind))
            mistakes += [_mistake(path, found, (*at, *key), problem(key)) for key in keys]
            if not _take_out(rest, out):
                return None, mistakes
        else:
            return (None if mistakes else struct), mistakes
    return None, mistakes


def _take_out(value: dict[str, Any], key: Key) -> bool:
    """Remove a key's value, or the whole list that contains it. Return False if there is nothing to remove."""
    for k, name in enumerate(key):
        if name not in value:
            return False
        if k == len(key) - 1 or not isinstance(value[name], dict):
            del value[name]
            return True
        value = value[name]
    return False


def _mistake(path: Path, found: dict[Key, Found], key: Key, problem: str) -> Mistake:
    line = found[key].line if key in found else None
    return Mistake(key, f"{_where(path, found, key)}: {problem}", line)


def _where(path: Path, found: dict[Key, Found], key: Key) -> str:
    if key in found:
        return f"{path}:{found[key].line}: {dotted((*found[key].at, *key))}"
    return f"{path}: {dotted((*found[()].at, *key) if () in found else key)}"


def _absolute(settings: Settings, folder: Path) -> Settings:
    """The same settings with every relative path made absolute against `folder`."""

    def at(path: str | None) -> str | None:
        return None if path is None else str(named_file(folder, path))

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
        return msgspec.structs.replace(source, path=str(named_file(folder, source.path)))
    if isinstance(source, Simulated) and source.pressed is not None:
        return msgspec.structs.replace(source, pressed=str(named_file(folder, source.pressed)))
    return source


def _explain(
    message: str, value: dict[str, Any], found: dict[Key, Found], root: dict[str, Any]
) -> tuple[list[Key], Callable[[Key], str], Key]:
    """Explain one msgspec error, which names a JSON path and one field: keys, each one's problem, the key to remove.

    A missing key that the file does have was an earlier mistake and is not reported again.
    """
    path = re.search(r" - at `\$\.?([^`]*)`$", message)
    key: Key = tuple(re.split(r"[.[]", path[1].replace("]", ""))) if path and path[1] else ()
    schema = _schema_at(key, value, root)
    if unknown := re.match(r"Object contains unknown field `(.*?)`(?: - at `|$)", message, re.DOTALL):
        names = list(schema["properties"])
        if (renamed := RENAMED.get(unknown[1])) in names:
            return [(*key, unknown[1])], lambda _: f"found a setting's old name, expected {renamed}", (*key, unknown[1])
        problem = f"found an unknown key, expected one of {', '.join(names)}{did_you_mean(unknown[1], names)}"
        return [(*key, unknown[1])], lambda _: problem, (*key, unknown[1])
    if missing := re.match(r"Object missing required field `(.*?)`", message):
        names = schema.get("required", [missing[1]])
        keys = [(*key, name) for name in names if (*key, name) not in found]
        return keys, lambda key: f"found nothing, expected {expectation(_schema_at(key, value, root))}", key
    given = _at(value, key)
    text = f"a list of {len(given)}" if isinstance(given, list) and schema.get("minItems") else found[key].text
    problem = f"found {text}, expected {expectation(schema, given)}"
    return [key], lambda _: problem, key


def _at(value: Any, key: Key) -> Any:
    for name in key:
        value = value[int(name)] if isinstance(value, list) else value[name]
    return value


def _schema_at(key: Key, value: Any, root: dict[str, Any]) -> dict[str, Any]:
    """The JSON Schema of the value at `key`; the tag in `value` resolves a tagged union."""
    schema = _resolved(root, value, root)
    for name in key:
        if "discriminator" in schema:  # the tag is missing or unknown, so only the tag itself can be explained
            return {"enum": list(schema["discriminator"]["mapping"])}
        value = value[int(name)] if isinstance(value, list) else value.get(name)
        schema = _resolved(schema["items"] if "items" in schema else schema["properties"][name], value, root)
    return schema


def _resolved(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> dict[str, Any]:
    """`schema` with its reference followed, and its union resolved by the tag in `value`."""
    if "anyOf" in schema and "discriminator" not in schema and isinstance(value, dict):  # a struct, or null
        schema = next((option for option in schema["anyOf"] if "$ref" in option), schema)
    if "anyOf" in schema and isinstance(value, list):  # a list, or null
        schema = next((option for option in schema["anyOf"] if "items" in option), schema)
    reference = schema.get("$ref")
    if "discriminator" in schema and isinstance(value, dict):
        tag = value.get(schema["discriminator"]["propertyName"])
        reference = schema["discriminator"]["mapping"].get(tag) if isinstance(tag, str) else None
    return root["$defs"][reference.rpartition("/")[2]] if reference else schema


def expectation(schema: dict[str, Any], given: object = None) -> str:
    """A description, for a person, of the values that `schema` accepts."""
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}{did_you_mean(given, schema['enum'])}"
    if "anyOf" in schema and "discriminator" not in schema:
        options = [expectation({**option}) for option in schema["anyOf"]]
        return " or ".join(options)
    kind = {"integer": "an integer", "number": "a number", "string": "a string", "boolean": "true or false"}
    kind["array"] = "a list"
    if schema.get("type") == "array" and schema.get("minItems"):
        kind["array"] = f"a list of {schema['minItems']} {kind[schema['items']['type']].split()[-1]}s"
    text = kind.get(schema.get("type", ""), "null" if schema.get("type") == "null" else "a mapping")
    if "minimum" in schema:
        text += f" from {schema['minimum']} to {schema['maximum']}"
    if "exclusiveMinimum" in schema:
        text += f" above {schema['exclusiveMinimum']}" + (f" to {schema['maximum']}" if "maximum" in schema else "")
    described = schema.get("description")
    return f"{text} ({described})" if described and "properties" not in schema else text


SENSORS_MAX = 16
_NEEDED = ("calibration", "source")  # required, because all sensors would share the defaults
_FOLDERS = ("recorder", "stitching")

Part = tuple[dict[str, Any], dict[Key, Found]]


def split(path: Path, value: dict[str, Any], found: dict[Key, Found]) -> tuple[list[Part], list[Mistake]]:
    """Split a file into one part per sensor, each like a file of that sensor alone, and find the whole's mistakes."""
    mistakes: list[Mistake] = []

    def wrong(key: Key, problem: str) -> None:
        line = found[key].line if key in found else None
        where = f"{path}:{line}: " if line else f"{path}: "
        mistakes.append(Mistake(key, f"{where}{dotted(key)}: {problem}", line))

    sensors = value[SENSORS]
    if not isinstance(sensors, dict) or not 1 <= len(sensors) <= SENSORS_MAX:
        count = len(sensors) if isinstance(sensors, dict) else found[(SENSORS,)].text
        wrong((SENSORS,), f"found {count}, expected 1 to {SENSORS_MAX} sensors, each its id and its settings")
        return [], mistakes
    common = {key: of_key for key, of_key in value.items() if key != SENSORS}
    for key in [key for key in common if key in OWN]:
        wrong((key,), f"found beside {SENSORS}, expected in each of them")
        del common[key]
    parts, places, bauds = [], dict[str, str](), dict[str, tuple[object, str]]()
    for sensor_id, own in sensors.items():
        at = (SENSORS, sensor_id)
        if not isinstance(own, dict):
            wrong(at, f"found {found[at].text}, expected a mapping of settings")
            continue
        if "sensor_id" in own:
            wrong((*at, "sensor_id"), f"found a second id, expected {sensor_id} alone")
        if HAND in own:
            wrong((*at, HAND), f"found in a sensor, expected beside {SENSORS}")
        for key in (*_NEEDED, *[FINGER] * (common.get(HAND) is not None)):
            if key not in own:
                wrong((*at, key), "found nothing, expected one of its own")
        for key, place in _places(own).items():
            if place in places:
                wrong((*at, key), f"found the same as in {places[place]}, expected another")
            places.setdefault(place, dotted((*at, key)))
        of_serial = _over(common, own).get("serial")
        if isinstance(of_serial, dict) and "device" in of_serial:
            first = bauds.setdefault(str(of_serial["device"]), (of_serial.get("baud"), sensor_id))
            if of_serial.get("baud") != first[0]:
                wrong((*at, "serial"), f"found a different baud, expected that of {SENSORS}.{first[1]} on this port")
        of_one = {key: where for key, where in found.items() if key[:1] != (SENSORS,)}
        of_one |= {key[2:]: replace(where, at=at) for key, where in found.items() if key[:2] == at}
        of_one["sensor_id",] = Found(found[at].line, sensor_id, at)
        parts.append(({**_over(common, own), "sensor_id": sensor_id}, of_one))
    return parts, mistakes


def _over(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The common settings overridden by a sensor's own, key by key within a section that both have."""
    both = {
        key: {**common[key], **own[key]} for key in common.keys() & own.keys() if _are_mappings(common[key], own[key])
    }
    return {**common, **own, **both}


def _are_mappings(*values: object) -> bool:
    return all(isinstance(value, dict) for value in values)


def _places(own: dict[str, Any]) -> dict[str, str]:
    """Settings that sensors cannot share: the calibration (with its reference) and the camera."""
    found = {"calibration": f"calibration {own['calibration']}"} if "calibration" in own else {}
    of_source = own.get("source")
    for name in ("device", "camera"):
        if isinstance(of_source, dict) and name in of_source:
            found["source"] = f"source {name} {of_source[name]}"
    return found


def own_folders(settings: Settings, found: dict[Key, Found]) -> Settings:
    """Put a sensor's folders below the common ones, named by its id, unless the sensor names its own."""
    changed = {}
    for section in _FOLDERS:
        where = found.get((section, "folder"))
        if where is None or not where.at:
            of_section = getattr(settings, section)
            folder = str(Path(of_section.folder) / settings.sensor_id)
            changed[section] = msgspec.structs.replace(of_section, folder=folder)
    return msgspec.structs.replace(settings, **changed)
