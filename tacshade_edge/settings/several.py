"""A settings file of several sensors, split into one per sensor, and what these cannot share."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import msgspec

from tacshade_edge.camera.sources import KINDS
from tacshade_edge.settings.model import HAND, OWN, SENSORS, Settings
from tacshade_edge.settings.strict_yaml import Key, Located, YamlFile, dotted

SENSORS_MAX: Final = 16
_NO_DEFAULT: Final = ("calibration", "source")
"""Keys that each sensor must give, because all sensors would share the default."""
_FOLDERS: Final = ("recorder", "stitching")
"""Sections with a folder of which each sensor has its own."""


def split(file: YamlFile) -> Iterator[YamlFile]:
    """Split a file into one per sensor, each like a file of that sensor alone.

    Raises ConfigError for what concerns several sensors.
    """
    sensors = file.value[SENSORS]
    if not isinstance(sensors, dict) or not 1 <= len(sensors) <= SENSORS_MAX:
        count = len(sensors) if isinstance(sensors, dict) else file.found[(SENSORS,)].text
        expected = f"expected 1 to {SENSORS_MAX} sensors, each its id and its settings"
        raise file.error((SENSORS,), f"found {count}, {expected}")
    common = {key: value for key, value in file.value.items() if key != SENSORS}
    # What one sensor needs for itself would hold for all of them.
    for key in common.keys() & OWN:
        raise file.error((key,), f"found beside {SENSORS}, expected in each of them")
    taken, bauds = dict[str, str](), dict[str, tuple[object, str]]()
    for sensor_id, own in sensors.items():
        _check_keys(file, sensor_id, own)
        _check_places(file, sensor_id, own, taken)
        value = {**_over(common, own), "sensor_id": sensor_id}
        _check_baud(file, sensor_id, value.get("serial"), bauds)
        yield YamlFile(file.path, value, _found_by_one(file, sensor_id))


def own_folders(settings: Settings, found: dict[Key, Located]) -> Settings:
    """Put a sensor's folders below the common ones, named by its id,
    unless the sensor names its own.
    """
    changed = {}
    for section in _FOLDERS:
        where = found.get((section, "folder"))
        # Only a sensor's own key has an `at`: a common or a default folder is everybody's.
        if where is None or not where.at:
            of_section = getattr(settings, section)
            folder = str(Path(of_section.folder) / settings.sensor_id)
            changed[section] = msgspec.structs.replace(of_section, folder=folder)
    return msgspec.structs.replace(settings, **changed)


def _check_keys(file: YamlFile, sensor_id: str, own: Any) -> None:
    """Check that a sensor has the keys that belong to one sensor, and no others."""
    at = (SENSORS, sensor_id)
    if not isinstance(own, dict):
        raise file.error(at, f"found {file.found[at].text}, expected a mapping of settings")
    if "sensor_id" in own:
        raise file.error((*at, "sensor_id"), f"found a second id, expected {sensor_id} alone")
    if HAND in own:
        raise file.error((*at, HAND), f"found in a sensor, expected beside {SENSORS}")
    for key in _NO_DEFAULT:
        if key not in own:
            raise file.error((*at, key), "found nothing, expected one of its own")


def _check_places(
    file: YamlFile, sensor_id: str, own: dict[str, Any], taken: dict[str, str]
) -> None:
    """Check that no sensor before has this one's calibration or camera; add these to `taken`."""
    for key, place in _places(own).items():
        at = (SENSORS, sensor_id, key)
        if place in taken:
            raise file.error(at, f"found the same as in {taken[place]}, expected another")
        taken[place] = dotted(at)


def _check_baud(
    file: YamlFile, sensor_id: str, serial: Any, bauds: dict[str, tuple[object, str]]
) -> None:
    """Check that sensors on one port agree on its speed; add this port's to `bauds`.

    Not converted yet, `serial` may be anything.
    """
    if not isinstance(serial, dict) or "device" not in serial:
        return
    # One process opens the port for all sensors on it.
    baud, first = bauds.setdefault(str(serial["device"]), (serial.get("baud"), sensor_id))
    if serial.get("baud") != baud:
        text = f"found a different baud, expected that of {SENSORS}.{first} on this port"
        raise file.error((SENSORS, sensor_id, "serial"), text)


def _found_by_one(file: YamlFile, sensor_id: str) -> dict[Key, Located]:
    """Where the file has each key of one sensor: common keys, and over them the sensor's own."""
    at = (SENSORS, sensor_id)
    found = {key: where for key, where in file.found.items() if key[:1] != (SENSORS,)}
    found |= {
        # Messages still show the key as the file has it, below `sensors`.
        key[len(at) :]: replace(where, at=at)
        for key, where in file.found.items()
        if key[: len(at)] == at
    }
    found["sensor_id",] = Located(file.found[at].line, sensor_id, at)
    return found


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
    # Compared as typed: that two names mean one camera shows when it is opened.
    found = {"calibration": f"calibration {own['calibration']}"}
    for name in (kind.names for kind in KINDS if kind.is_camera):
        if isinstance(own["source"], dict) and name in own["source"]:
            found["source"] = f"source {name} {own['source'][name]}"
    return found
