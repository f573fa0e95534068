"""Reports which taught objects touch, and takes note when `teach` has changed them."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.calibration.files import objects_file
from tacshade_edge.calibration.files.objects_file import Known
from tacshade_edge.errors import ConfigError
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.robot.verbs import object_text
from tacshade_edge.types import Need, Reconstruction, TouchedObject
from tacshade_edge.wire.messages import encode_object

_log = logging.getLogger(__name__)

# An object has its name for this long before it is reported: as a contact begins, its shape passes
# through those of other objects.
SETTLED_NS = 200_000_000


@dataclass(slots=True)
class _Named:
    """An object's latest name, since when it has it, and the name that was reported."""

    name: str | None
    since_ns: int
    reported: str | None = None


class ObjectEvents(FrameObserver):
    """Publishes ``event/object`` when an object's name has settled, and tells the robot, if there
    is one.

    It requests depth only if something was taught and a robot or a subscriber wants the names.
    """

    def __init__(
        self,
        publish_event: Callable[[str, bytes], None],
        has_listener: Callable[[str], bool],
        tell_robot: Callable[[str], None] | None = None,
    ) -> None:
        self._publish_event, self._has_listener = publish_event, has_listener
        self._tell_robot = tell_robot
        self._taught = False
        self._objects: dict[int, _Named] = {}

    def need(self) -> Need:
        wanted = self._tell_robot is not None or self._has_listener("event/object")
        return Need.DEPTH if self._taught and wanted else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        self._taught = seen.calibration is not None and bool(seen.calibration.known)
        result = seen.reconstruction
        if result is None or result.touched or not (self._taught or self._objects):
            return
        self._objects = {
            each.label if each.id is None else each.id: self._followed(result, each)
            for each in result.objects
        }

    def _followed(self, result: Reconstruction, each: TouchedObject) -> _Named:
        known = self._objects.get(each.label if each.id is None else each.id)
        if known is None or known.name != each.name:
            # Kept: a name that flickers and comes back is no news.
            reported = known.reported if known else None
            return _Named(each.name, result.t_ns, reported)
        if (
            each.name is not None
            and each.probability is not None
            and each.name != known.reported
            and result.t_ns - known.since_ns >= SETTLED_NS
        ):
            known.reported = each.name
            self._publish_event("event/object", encode_object(result, each))
            if self._tell_robot is not None:
                text = object_text(result.seq, result.t_ns, each.name, each.probability)
                self._tell_robot(text)
        return known


class TaughtObjects:
    """The file of objects beside a calibration, as it was last read."""

    def __init__(self, calibration: str) -> None:
        self._path = objects_file.path_beside(calibration)
        self._written = _written(self._path)

    def changed(self) -> Known | None:
        """The objects, if they have changed since the last call; None if not, or if they cannot be
        read.
        """
        written = _written(self._path)
        if written == self._written:
            return None
        self._written = written
        try:
            known = objects_file.load(self._path)
        except ConfigError as error:
            # Known as written by now, so that a bad file is reported once.
            _log.warning("%s; the objects stay as they were", error)
            return None
        names = {each.name for objects in known.values() for each in objects}
        _log.info("objects known: %s", ", ".join(sorted(names)) or "none")
        return known


def _written(path: Path) -> tuple[int, int] | None:
    """What changes when a file is written; None without one."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    # Files are replaced by renaming, twice perhaps within a tick of the file system's clock; the
    # new one has another inode.
    return found.st_mtime_ns, found.st_ino
