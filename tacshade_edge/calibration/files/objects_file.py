"""The objects that a sensor was taught: one ``.npz`` file next to its calibration, the same for
every sensor.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from tacshade_edge.errors import ConfigError
from tacshade_edge.files import npz
from tacshade_edge.files.atomic_files import disk_errors, sync, write_whole
from tacshade_edge.files.npz import Content
from tacshade_edge.quoting import shown
from tacshade_edge.types import KnownObject

VERSION = 1
"""It also counts the descriptions, whose numbers change with `sensor.recognition.description`."""
OBJECTS_MAX, TOUCHES_MAX = 256, 64
"""Greatest number of objects, and of touches of one object that a profile keeps."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
_EXPECTED = "1 to 64 letters, digits, '_', '-' or '.', beginning with a letter or digit"
Known = Mapping[str, tuple[KnownObject, ...]]
"""The known objects of each profile, by its name."""
_Counts = dict[
    str, dict[str, Annotated[int, Meta(ge=1, le=TOUCHES_MAX)]]
]  # by profile, of each object


def path_beside(calibration_path: str | os.PathLike[str]) -> Path:
    """The path of the objects for a calibration's file."""
    return Path(calibration_path).with_suffix(".objects.npz")


def check_name(name: str) -> str:
    """Return a name that files, MQTT and the serial line can carry. Raises ConfigError."""
    if not _NAME.fullmatch(name):
        raise ConfigError(f"name: found {shown(name, 80)}, expected {_EXPECTED}")
    return name


def save(path: Path, known: Known) -> None:
    """Write the objects whole; without any, delete the file. Raises DeviceError."""
    with disk_errors(path.parent):
        if not any(known.values()):
            path.unlink(missing_ok=True)
            sync(path.parent)
            return
        counts = {
            profile: {each.name: len(each.touches) for each in objects}
            for profile, objects in known.items()
        }
        arrays = {
            profile: np.concatenate([each.touches for each in objects])
            for profile, objects in known.items()
        }
        meta = {"version": VERSION, "touches": {p: list(c.items()) for p, c in counts.items()}}
        write_whole(path, Content(meta, arrays).packed())


def load(path: Path) -> Known:
    """Read the objects; none without a file. Raises ConfigError."""
    if not os.path.lexists(path):
        return {}
    content = npz.read(str(path), "file of objects", "`tacshade-edge teach`")
    if content.meta.get("version") != VERSION:
        found = shown(content.meta.get("version"), 20)
        expected = f"expected {VERSION}; delete it and teach again"
        raise ConfigError(f"{path}: found version {found} of the objects, {expected}")
    try:
        return _objects(content)
    except ValueError as error:
        raise ConfigError(
            f"{path}: not a file of objects: {shown(error)}; delete it and teach again"
        ) from None


def _objects(content: Content) -> Known:
    stated = msgspec.convert(content.meta.get("touches"), dict[str, list[tuple[str, int]]])
    counts = msgspec.convert({p: dict(c) for p, c in stated.items()}, _Counts)
    if set(counts) != set(content.arrays):
        raise ValueError("found other arrays than the profiles that it names")
    return {profile: _of_profile(stated[profile], content.arrays[profile]) for profile in counts}


_AXES = 2  # touches, numbers of a description


def _of_profile(counts: Sequence[tuple[str, int]], touches: Any) -> tuple[KnownObject, ...]:
    names = [name for name, _ in counts]
    if len(set(names)) < len(names) or not 0 < len(names) <= OBJECTS_MAX:
        raise ValueError(f"expected 1 to {OBJECTS_MAX} objects with different names")
    if wrong := [name for name in names if not _NAME.fullmatch(name)]:
        raise ValueError(f"found the name {shown(wrong[0], 80)}, expected {_EXPECTED}")
    total = sum(count for _, count in counts)
    if touches.dtype != np.float32 or touches.ndim != _AXES or len(touches) != total:
        raise ValueError(f"expected float32 descriptions of {total} touches")
    if not (touches.shape[1] and np.isfinite(touches).all()):
        raise ValueError("expected finite numbers in each description")
    ends = np.cumsum([count for _, count in counts])[:-1]
    return tuple(
        KnownObject(name, part) for name, part in zip(names, np.split(touches, ends), strict=True)
    )


def taught(known: Known, profile: str, name: str, touches: Any) -> Known:
    """The objects with more touches, float32 (n, D), of one of them or of a new one. Raises
    ConfigError (too many).
    """
    objects = {each.name: each for each in known.get(profile, ())}
    before = objects.get(name)
    whole = touches if before is None else np.concatenate((before.touches, touches))
    if len(whole) > TOUCHES_MAX:
        raise ConfigError(
            f"{name}: found {len(whole)} touches, expected at most {TOUCHES_MAX} of one object"
        )
    objects[name] = KnownObject(name, np.ascontiguousarray(whole, np.float32))
    if len(objects) > OBJECTS_MAX:
        raise ConfigError(f"{name}: found {OBJECTS_MAX} objects, expected no more of them")
    return {**known, profile: tuple(objects.values())}


def without(known: Known, name: str) -> Known:
    """The objects without one of them."""
    left = {p: tuple(o for o in objects if o.name != name) for p, objects in known.items()}
    return {profile: objects for profile, objects in left.items() if objects}
