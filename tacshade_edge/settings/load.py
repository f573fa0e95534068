"""Loads a settings file as `Settings` and reports a mistake with its line.

A file may have several sensors: keys outside ``sensors`` apply to all, keys in a sensor to that
one. With ``hand_id`` next to ``sensors`` they are the fingers of a hand, and each has its
``hand_T_sensor``.

::

    mqtt: {host: localhost}
    profile: balanced
    sensors:
      left-thumb: {calibration: thumb.npz, source: {kind: v4l2, device: /dev/v4l/by-id/thumb}}
      left-index:
        calibration: index.npz
        source: {kind: v4l2, device: /dev/v4l/by-id/index}
        profile: fast
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import did_you_mean, shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.sensor.profiles import AUTO
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.model import (
    FINGER,
    HAND,
    OWN,
    SENSORS,
    Files,
    Rpicam,
    Settings,
    Simulated,
    Source,
    V4l2,
    wrong_with,
)
from tacshade_edge.settings.strict_yaml import Key, Located, YamlFile, dotted

T = TypeVar("T")
_V4L2_EXPOSURE_US = 100  # V4L2_CID_EXPOSURE_ABSOLUTE


@dataclass(frozen=True, slots=True)
class Document:
    """A valid settings file, with absolute paths.

    `found`: each given key's place; `several`: it has ``sensors``.
    """

    path: Path
    settings: Settings
    found: dict[Key, Located]
    several: bool = False

    def where(self, *key: str) -> str:
        """``FILE:LINE: path.to.key`` (without a line if the key has its default)."""
        return YamlFile(self.path, None, self.found).where(key)


@dataclass(frozen=True, slots=True)
class Hand:
    """The hand that a file's sensors form; `common` are the settings outside ``sensors``: the
    broker, as the hand logs in.
    """

    common: Document
    hand_id: str
    fingers: tuple[str, ...]


def load(path: Path, sensor_id: str | None = None) -> Document:
    """Read and check a settings file and return one sensor's document;
    without `sensor_id` there must be only one.

    Raises ConfigError, ``FILE:LINE: path.to.key: found …, expected …``, for the first mistake.
    """
    documents = load_all(path)
    if sensor_id is None and len(documents) == 1:
        return documents[0]
    for document in documents:
        if document.settings.sensor_id == sensor_id:
            return document
    ids = ", ".join(document.settings.sensor_id for document in documents)
    if sensor_id is None:
        raise ConfigError(
            f"{path}: found several sensors but no --sensor, expected --sensor with one of {ids}"
        )
    raise ConfigError(f"--sensor: found {shown(sensor_id)}, expected one of {ids} ({path})")


def load_all(path: Path) -> tuple[Document, ...]:
    """Read and check a settings file with one sensor or several. Raises ConfigError like `load`."""
    file = strict_yaml.read(path)
    several = isinstance(file.value, dict) and SENSORS in file.value
    return tuple(_document(part, several) for part in (_split(file) if several else [file]))


def _document(file: YamlFile, several: bool) -> Document:
    settings = convert(file, Settings)
    _check_profile(file, settings)
    _check_size(file, settings.source)
    _check_exposure(file, settings.source)
    _check_hand(file, settings, several)
    settings = _absolute(settings, file.path.absolute().parent)
    return Document(
        file.path, _own_folders(settings, file.found) if several else settings, file.found, several
    )


def load_hand(path: Path) -> Hand | None:
    """Read the hand that a settings file names, or None if it names none.

    Raises ConfigError like `load`.
    """
    fingers = tuple(document.settings.sensor_id for document in load_all(path))
    file = strict_yaml.read(path)
    kept = {key: file.value[key] for key in (HAND, "mqtt") if file.value.get(key) is not None}
    settings = _absolute(msgspec.convert(kept, Settings), path.absolute().parent)
    return (
        Hand(Document(path, settings, file.found, True), settings.hand_id, fingers)
        if settings.hand_id
        else None
    )


def _check_hand(file: YamlFile, settings: Settings, several: bool) -> None:
    """Check that a finger belongs to a hand and has its place in it,
    and that a hand has several sensors.
    """
    if settings.hand_id is not None and not several:
        raise file.error((HAND,), f"found {settings.hand_id}, expected it beside {SENSORS} only")
    if settings.hand_T_sensor is None:
        if settings.hand_id is not None:
            raise file.error(
                (FINGER,),
                f"found nothing, expected the sensor's place in the hand that {HAND} names",
            )
    elif settings.hand_id is None:
        raise file.error(
            (FINGER,), f"found it without {HAND}, expected it in a hand's sensors only"
        )
    elif problem := wrong_with(settings.hand_T_sensor):
        raise file.error((FINGER,), problem)


def _check_size(file: YamlFile, source: Source) -> None:
    """Refuse a camera's width without a height, and a height without a width."""
    if not isinstance(source, V4l2 | Rpicam):
        return
    missing = [name for name in ("width_px", "height_px") if getattr(source, name) is None]
    if len(missing) == 1:
        expected = "expected both width_px and height_px, or neither"
        raise file.error(("source",), f"found no {missing[0]}, {expected}")


def _check_exposure(file: YamlFile, source: Source) -> None:
    """Refuse an exposure that does not fit into the frame period,
    which slows the camera down without notice.
    """
    if isinstance(source, Rpicam):
        name, value, unit_us = "exposure_us", source.exposure_us, 1
    elif isinstance(source, V4l2) and source.exposure is not None:
        name, value, unit_us = "exposure", source.exposure, _V4L2_EXPOSURE_US
    else:
        return
    most = (1_000_000 - 1) // (source.fps * unit_us)
    if value > most:
        expected = (
            f"expected at most {most}, because a frame takes {1e6 / source.fps:.0f} µs at "
            f"{source.fps} frames/s"
        )
        raise file.error(("source", name), f"found {value}, {expected}")


def _check_profile(file: YamlFile, settings: Settings) -> None:
    """Check that `AUTO` has a budget, and nothing else."""
    budget_ms = settings.latency_budget_ms
    if (settings.profile == AUTO) == (budget_ms is not None):
        return
    given = "nothing" if budget_ms is None else f"{budget_ms:g}"
    expected = "a number of milliseconds" if budget_ms is None else f"it with profile {AUTO} only"
    raise file.error(
        ("latency_budget_ms",),
        f"found {given} with profile {settings.profile}, expected {expected}",
    )


def to_yaml(settings: Settings) -> str:
    """The text of a settings file with these settings."""
    text: str = yaml.safe_dump(msgspec.to_builtins(settings), sort_keys=False, allow_unicode=True)
    return text


def schema_of(kind: type) -> dict[str, Any]:
    """The JSON Schema of a struct, with those of the structs in it."""
    schema = msgspec.json.schema(kind)
    return {**schema["$defs"][kind.__name__], "$defs": schema["$defs"]}


def convert(file: YamlFile, kind: type[T], at: Key = ()) -> T:
    """Convert the value at a key to a struct. Raises ConfigError like `load`."""
    value = file.value
    for name in at:
        value = value[name]
    if not isinstance(value, dict):
        named = f"{dotted(at)}: " if at else ""
        text = (
            f"{file.path}:{file.found[at].line}: {named}found {file.found[at].text}, expected a "
            "mapping of settings"
        )
        raise ConfigError(text)
    try:
        return msgspec.convert(value, kind)
    except msgspec.ValidationError as error:
        key, problem = _explained(str(error), value, file.found, at, schema_of(kind))
        raise file.error(key, problem) from None


def _explained(
    message: str, value: dict[str, Any], found: dict[Key, Located], at: Key, root: dict[str, Any]
) -> tuple[Key, str]:
    """The key and the problem of one msgspec error,
    which names a JSON path below `at` and one field.
    """
    path = re.search(r" - at `\$\.?([^`]*)`$", message)
    key: Key = tuple(re.split(r"[.[]", path[1].replace("]", ""))) if path and path[1] else ()
    if unknown := re.match(
        r"Object contains unknown field `(.*?)`(?: - at `|$)", message, re.DOTALL
    ):
        given, schema = _at(key, value, root)
        names = list(_option(schema, given, root)["properties"])
        text = (
            "found an unknown key, expected one of "
            f"{', '.join(names)}{did_you_mean(unknown[1], names)}"
        )
        return (*at, *key, unknown[1]), text
    if missing := re.match(r"Object missing required field `(.*?)`", message):
        key = (*key, missing[1])
        return (*at, *key), f"found nothing, expected {expectation(_at(key, value, root)[1])}"
    given, schema = _at(key, value, root)
    text = f"a list of {len(given)}" if isinstance(given, list) and key else found[(*at, *key)].text
    return (*at, *key), f"found {text}, expected {expectation(schema, given)}"


def _at(key: Key, value: Any, root: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
    """The value at `key` (None if it is missing) and its JSON Schema."""
    schema = root
    for name in key:
        option = _option(schema, value, root)
        schema = option["items"] if isinstance(value, list) else option["properties"][name]
        value = value[int(name)] if isinstance(value, list) else value.get(name)
    return value, schema


def _option(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> dict[str, Any]:
    """The alternative of `schema` for a mapping or list;
    a tag chooses the struct, and if wrong is all there is.
    """
    options: list[dict[str, Any]]
    options = [
        root["$defs"][o["$ref"].rpartition("/")[2]] if "$ref" in o else o
        for o in schema.get("anyOf", [schema])
    ]
    options = [
        option
        for option in options
        if ("items" if isinstance(value, list) else "properties") in option
    ]
    if "discriminator" not in schema:
        return options[0]
    tag = schema["discriminator"]["propertyName"]
    tags = list(schema["discriminator"]["mapping"])
    chosen = [option for option in options if value.get(tag) in option["properties"][tag]["enum"]]
    return chosen[0] if chosen else {"properties": {tag: {"enum": tags}}}


def expectation(schema: dict[str, Any], given: object = None) -> str:
    """A description, for a person, of the values that `schema` accepts."""
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}{did_you_mean(given, schema['enum'])}"
    if "anyOf" in schema and "discriminator" not in schema:
        return " or ".join(map(expectation, schema["anyOf"]))
    kind = {
        "integer": "an integer",
        "number": "a number",
        "string": "a string",
        "boolean": "true or false",
    }
    kind |= {"array": "a list", "null": "null"}
    text = kind.get(schema.get("type", ""), "a mapping")
    if schema.get("minItems"):
        text = f"a list of {schema['minItems']} {kind[schema['items']['type']].split()[-1]}s"
    if "minimum" in schema:
        text += f" from {schema['minimum']} to {schema['maximum']}"
    if "exclusiveMinimum" in schema:
        text += f" above {schema['exclusiveMinimum']} to {schema['maximum']}"
    described = schema.get("description")
    return f"{text} ({described})" if described and "properties" not in schema else text


SENSORS_MAX = 16


def _split(file: YamlFile) -> Iterator[YamlFile]:
    """Split a file into one per sensor, each like a file of that sensor alone;
    check what concerns several.
    """
    sensors, found = file.value[SENSORS], file.found
    if not isinstance(sensors, dict) or not 1 <= len(sensors) <= SENSORS_MAX:
        count = len(sensors) if isinstance(sensors, dict) else found[(SENSORS,)].text
        expected = f"expected 1 to {SENSORS_MAX} sensors, each its id and its settings"
        raise file.error((SENSORS,), f"found {count}, {expected}")
    common = {key: value for key, value in file.value.items() if key != SENSORS}
    for key in common.keys() & OWN:
        raise file.error((key,), f"found beside {SENSORS}, expected in each of them")
    places, bauds = dict[str, str](), dict[str, tuple[object, str]]()
    for sensor_id, own in sensors.items():
        at = (SENSORS, sensor_id)
        if not isinstance(own, dict):
            raise file.error(at, f"found {found[at].text}, expected a mapping of settings")
        if "sensor_id" in own:
            raise file.error((*at, "sensor_id"), f"found a second id, expected {sensor_id} alone")
        if HAND in own:
            raise file.error((*at, HAND), f"found in a sensor, expected beside {SENSORS}")
        for key in ("calibration", "source"):  # all sensors would share the defaults
            if key not in own:
                raise file.error((*at, key), "found nothing, expected one of its own")
        for key, place in _places(own).items():
            if place in places:
                raise file.error(
                    (*at, key), f"found the same as in {places[place]}, expected another"
                )
            places[place] = dotted((*at, key))
        value = {**_over(common, own), "sensor_id": sensor_id}
        if isinstance(serial := value.get("serial"), dict) and "device" in serial:
            baud, first = bauds.setdefault(str(serial["device"]), (serial.get("baud"), sensor_id))
            if serial.get("baud") != baud:
                text = f"found a different baud, expected that of {SENSORS}.{first} on this port"
                raise file.error((*at, "serial"), text)
        of_one = {key: where for key, where in found.items() if key[:1] != (SENSORS,)}
        of_one |= {key[2:]: replace(where, at=at) for key, where in found.items() if key[:2] == at}
        of_one["sensor_id",] = Located(found[at].line, sensor_id, at)
        yield YamlFile(file.path, value, of_one)


def _over(common: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """The common settings overridden by a sensor's own,
    key by key within a section that both have.
    """
    both = {
        key: {**common[key], **own[key]}
        for key in common.keys() & own.keys()
        if isinstance(common[key], dict) and isinstance(own[key], dict)
    }
    return {**common, **own, **both}


def _places(own: dict[str, Any]) -> dict[str, str]:
    """Settings that sensors cannot share: the calibration (with its reference) and the camera."""
    found = {"calibration": f"calibration {own['calibration']}"}
    for name in ("device", "camera"):
        if isinstance(own["source"], dict) and name in own["source"]:
            found["source"] = f"source {name} {own['source'][name]}"
    return found


def _absolute(settings: Settings, folder: Path) -> Settings:
    """The same settings with every relative path made absolute against `folder`."""

    def at(section: Any, *names: str) -> Any:
        paths = {name: getattr(section, name, None) for name in names}
        absolute = {
            name: str(named_file(folder, path)) for name, path in paths.items() if path is not None
        }
        return msgspec.structs.replace(section, **absolute)

    source = settings.source
    absolute: Settings = msgspec.structs.replace(
        at(settings, "calibration"),
        source=at(source, "path", "pressed") if isinstance(source, Files | Simulated) else source,
        mqtt=at(settings.mqtt, "password_file", "ca_file"),
        recorder=at(settings.recorder, "folder"),
        stitching=at(settings.stitching, "folder"),
    )
    return absolute


def _own_folders(settings: Settings, found: dict[Key, Located]) -> Settings:
    """Put a sensor's folders below the common ones, named by its id,
    unless the sensor names its own.
    """
    changed = {}
    for section in ("recorder", "stitching"):
        where = found.get((section, "folder"))
        if where is None or not where.at:
            of_section = getattr(settings, section)
            folder = str(Path(of_section.folder) / settings.sensor_id)
            changed[section] = msgspec.structs.replace(of_section, folder=folder)
    return msgspec.structs.replace(settings, **changed)
