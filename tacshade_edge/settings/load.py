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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import yaml

from tacshade_edge.errors import ConfigError
from tacshade_edge.plausibility.hand_places import judge_fingers
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.quoting import shown
from tacshade_edge.regular_files import named_file
from tacshade_edge.section import PATH, Section, marked
from tacshade_edge.settings import strict_yaml
from tacshade_edge.settings.conversion import convert
from tacshade_edge.settings.model import FINGER, HAND, SENSORS, Settings, wrong_with
from tacshade_edge.settings.several import own_folders, split
from tacshade_edge.settings.strict_yaml import Key, Located, YamlFile

T = TypeVar("T", bound=Section)


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
    # A file of one sensor needs no name; one of several never stands for its first sensor.
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
    try:
        file = strict_yaml.read(path)
    except ConfigError as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        # Whoever has none yet may not know what writes one.
        how = "tacshade-edge capture FOLDER writes FOLDER/config.yaml for a new sensor"
        raise ConfigError(f"{error}; {how}", code=error.code) from None
    # By the key alone: a mistake below it then has the line that it has in such a file.
    several = isinstance(file.value, dict) and SENSORS in file.value
    parts = split(file) if several else [file]
    documents = tuple(_document(part, several=several) for part in parts)
    doubted = doubted_finger(documents)
    if doubted is not None and doubted[1].impossible:
        raise ConfigError(f"{doubted[0].where(FINGER)}: {doubted[1]}")
    return documents


def doubted_finger(
    documents: Sequence[Document], sizes_mm: Mapping[str, float] | None = None
) -> tuple[Document, Suspicion] | None:
    """The finger whose place is doubted beside those of the others, and why; `sizes_mm` are those
    of domes by sensor.
    """
    by_name = {each.settings.sensor_id: each for each in documents}
    places = {
        name: (place[0], place[1], place[2])
        for name, each in by_name.items()
        if (place := each.settings.hand_T_sensor) is not None
    }
    found = judge_fingers(places, sizes_mm or {})
    return None if found is None else (by_name[found[0]], found[1])


def _document(file: YamlFile, *, several: bool) -> Document:
    settings = convert(file, Settings)
    _check_rules(file, settings)
    _check_hand(file, settings, several=several)
    # Paths count from the file, wherever the daemon is started.
    settings = _absolute(settings, file.path.absolute().parent)
    if several:
        settings = own_folders(settings, file.found)
    return Document(file.path, settings, file.found, several)


def check_source(document: Document) -> None:
    """Look at what the source's settings name, without opening it.

    Raises ConfigError with its line.
    """
    source = document.settings.source
    try:
        source.check()
    except ConfigError as error:
        raise ConfigError(f"{document.where('source', source.names)}: {error}") from None


def load_hand(path: Path) -> Hand | None:
    """Read the hand that a settings file names, or None if it names none.

    Raises ConfigError like `load`.
    """
    fingers = tuple(document.settings.sensor_id for document in load_all(path))
    file = strict_yaml.read(path)
    # load_all has checked this much of the file; whatever else it has belongs to the sensors.
    kept = {key: file.value[key] for key in (HAND, "mqtt") if file.value.get(key) is not None}
    settings = _absolute(msgspec.convert(kept, Settings), path.absolute().parent)
    return (
        Hand(Document(path, settings, file.found, several=True), settings.hand_id, fingers)
        if settings.hand_id
        else None
    )


def _check_hand(file: YamlFile, settings: Settings, *, several: bool) -> None:
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
    # Seven numbers of the right type may still be no rotation, which no type can state.
    elif problem := wrong_with(settings.hand_T_sensor):
        raise file.error((FINGER,), problem)


def _check_rules(file: YamlFile, settings: Settings) -> None:
    """Check the rules between the settings, those of the whole before those of a section."""
    sections = [((), settings), *(((name,), each) for name, each in _sections(settings).items())]
    for key, section in sections:
        if wrong := section.misfit():
            raise file.error((*key, *wrong[0]), wrong[1])


def _sections(section: Section) -> dict[str, Section]:
    values = {name: getattr(section, name) for name in section.__struct_fields__}
    return {name: value for name, value in values.items() if isinstance(value, Section)}


def to_yaml(settings: Settings) -> str:
    """The text of a settings file with these settings."""
    # In the order of the types, which is the order in which people read them.
    text: str = yaml.safe_dump(msgspec.to_builtins(settings), sort_keys=False, allow_unicode=True)
    return text


def _absolute(section: T, folder: Path) -> T:
    """The same settings with every relative path made absolute against `folder`."""
    changed: dict[str, Any] = {
        name: str(named_file(folder, path))
        for name in marked(type(section), PATH)
        if (path := getattr(section, name)) is not None
    }
    changed |= {name: _absolute(each, folder) for name, each in _sections(section).items()}
    return msgspec.structs.replace(section, **changed)
