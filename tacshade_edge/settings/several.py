"""One settings file with several sensors: keys outside ``sensors`` apply to all, keys in a sensor to that one.

::

    mqtt: {host: localhost}
    profile: balanced
    sensors:
      left-thumb: {calibration: thumb.npz, source: {kind: v4l2, device: /dev/v4l/by-id/thumb}}
      left-index: {calibration: index.npz, source: {kind: v4l2, device: /dev/v4l/by-id/index}, profile: fast}

With ``hand_id`` next to ``sensors`` they are the fingers of a hand, and each has its ``hand_T_sensor``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from tacshade_edge.settings.model import FINGER, HAND, OWN, SENSORS, Settings
from tacshade_edge.settings.strict_yaml import Found, Key, Mistake, dotted

SENSORS_MAX = 16
_NEEDED = ("calibration", "source")  # required, because all sensors would share the defaults
_FOLDERS = ("recorder", "stitching")

Part = tuple[dict[str, Any], dict[Key, Found]]


def split(path: Path, value: dict[str, Any], found: dict[Key, Found]) -> tuple[list[Part], list[Mistake]]:
    """Split a file into one part per sensor, each like a file of that sensor alone, and find the whole's mistakes.

    Parameters
    ----------
    path : Path
    value : dict
        The file's values, with ``sensors``.
    found : dict
        The place of each key.
    """
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
