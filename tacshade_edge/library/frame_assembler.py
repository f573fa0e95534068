"""Assemble results from the messages that a daemon publishes for each frame."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.library.result import Result, result_of
from tacshade_edge.quoting import quoted
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.contact.objects import objects_of
from tacshade_edge.sensor.contact.tracking import ContactTracker, follow
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, labels_by_cell
from tacshade_edge.types import (
    F32,
    Geometry,
    HeightMap,
    ObjectCloud,
    Reconstruction,
    Touch,
    TouchedObject,
)
from tacshade_edge.wire.binary import HeightMessage, ShearMessage, SigmaMessage
from tacshade_edge.wire.sensor_topics import Contact, Info, ObjectEvent, TouchNumbers
from tacshade_edge.wire.topics import (
    OF_SENSORS,
    decode_contact,
    decode_info,
    decode_object_event,
    decode_state,
    decode_touch,
)

_STREAMS: Final = ("height", "cloud", "shear", "sigma")
TOPICS: Final = (*_STREAMS, "touch", "contact", "event/object", "info", "state")
_SEQ: Final = struct.Struct("<8xI")


@dataclass(frozen=True, slots=True)
class _Whole:
    """All messages published for one frame; without contact, only `contact` is required."""

    contact: Contact
    streams: dict[str, bytes]
    touch: Touch | None


class FrameAssembler:
    """Takes one daemon's messages in the order in which the daemon sent them;
    keeps the newest complete frame.

    `info` and `state` are as last published. `passed_over` counts the frames that a newer one
    replaced, that arrived incomplete, or that do not match the published calibration.
    """

    def __init__(self) -> None:
        self.info, self.state, self.passed_over = Info(geometry=None, profile=""), "", 0
        self._height = HeightMap(
            np.zeros((0, 0), np.float32), np.zeros((0, 0), np.bool_), 0.0, 0.0, 1.0
        )
        self._tracker = ContactTracker()
        self.forget()

    def forget(self) -> None:
        """Drop all pending messages: the following ones come from another connection."""
        self._latest: dict[str, bytes] = {}
        self._touch: TouchNumbers | None = None
        self._newest: _Whole | None = None
        # Of this contact, by label.
        self._named: dict[int, ObjectEvent] = {}

    @property
    def whole(self) -> bool:
        """Whether a complete frame is waiting."""
        return self._newest is not None

    def add(self, topic: str, payload: bytes) -> None:
        """Take a message. Raises DecodeError."""
        if topic in _STREAMS:
            self._latest[topic] = payload
        elif topic == "touch":
            self._touch = decode_touch(payload)
        elif topic == "event/object":
            event = decode_object_event(payload)
            self._named[event.label] = event
        elif topic == "state":
            self.state = decode_state(payload)
        elif topic == "info":
            self.info = decode_info(payload)
        elif topic == "contact":
            self._add(decode_contact(payload))
        else:
            raise DecodeError(
                f"found the topic {quoted(topic)}, expected one of {', '.join(TOPICS)}"
            )

    def _add(self, contact: Contact) -> None:
        """Complete a frame: ``contact`` is the last message that a daemon sends for it."""
        if not contact.contact and not contact.touched:
            # Names are of one contact: the next object may be another, under the same label.
            self._named.clear()
        # The binary header has 32 bits of the number, JSON has all.
        seq = contact.seq & 0xFFFFFFFF
        # A stream may still be of an earlier frame: the daemon sends each only while somebody
        # listens, and a newer frame replaces what waits.
        streams = {
            name: data
            for name, data in self._latest.items()
            if len(data) >= _SEQ.size and _SEQ.unpack_from(data)[0] == seq
        }
        # Lost on the way; a result with a contact but without its heights would be wrong.
        if contact.contact and not {"height", "cloud"} <= streams.keys():
            self.passed_over += 1
            return
        # The reader did not come in time: the newest frame replaces the waiting one.
        self.passed_over += self._newest is not None
        self._newest = _Whole(contact, streams, _touch_of(contact, self._touch))

    def take(self) -> Result | None:
        """The result of the newest complete frame;
        None if there is none or it cannot be decoded.
        """
        whole, self._newest = self._newest, None
        if whole is None:
            return None
        try:
            result = self._result(whole)
        except DecodeError:
            result = None
        self.passed_over += result is None
        return result

    def _result(self, whole: _Whole) -> Result | None:
        if (known := self.info.geometry) is None:
            return None
        contact, geometry = whole.contact, known.geometry
        found = {name: OF_SENSORS[name].decode(name, data) for name, data in whole.streams.items()}
        height, cloud, shear, sigma = (found.get(name) for name in _STREAMS)
        # A daemon that is calibrated anew publishes `info` again, while frames of the old
        # calibration may still be on their way: their pixels are elsewhere now.
        if height is not None and height.calibration_crc32 != known.calibration_crc32:
            return None
        _check_grids(height, shear, sigma)
        shear_mm = None if shear is None else shear.shear_mm
        points = ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16))
        if cloud is not None:
            points = ObjectCloud(cloud.points_mm, cloud.labels)
        objects: tuple[TouchedObject, ...] = ()
        volume_mm3 = 0.0
        if height is None:
            self._height = _untouched(self._height)
        else:
            self._height, objects, volume_mm3 = _touched(height, points, shear_mm, geometry)
            objects = tuple(self._with_name(each) for each in objects)
        made = Reconstruction(
            seq=contact.seq,
            t_ns=contact.t_ns,
            # Older daemons have no wall clock in `contact`.
            wall_ns=contact.wall_ns or (height.wall_ns if height else 0),
            profile=self.info.profile,
            valid=not contact.reason_code,
            reason=_reason(contact.reason_code),
            contact=bool(contact.contact),
            saturated=height is not None and height.saturated,
            degraded=_reason(contact.degraded_code),
            height=self._height,
            cloud=points,
            objects=objects,
            volume_mm3=volume_mm3,
            shear_mm=shear_mm,
            sigma_mm=None if sigma is None else sigma.sigma_mm,
            touch=whole.touch,
            touched=bool(contact.touched),
        )
        # A frame without a result must not end the tracks of its objects.
        if made.valid:
            made = follow(self._tracker, made)
        return result_of(made, geometry, height.pose if height else None, None)

    def _with_name(self, touched: TouchedObject) -> TouchedObject:
        named = self._named.get(touched.label)
        if named is None:
            return touched
        return replace(touched, name=named.name, probability=named.probability)


def _touched(
    message: HeightMessage, cloud: ObjectCloud, shear_mm: F32 | None, geometry: Geometry
) -> tuple[HeightMap, tuple[TouchedObject, ...], float]:
    """The height map, its objects and their volume in mm³;
    contact and objects are those of the points.
    """
    height_mm, grid = message.height_mm, _grid(message)
    if (height_mm > geometry.height_max_mm).any():
        raise DecodeError(
            f"height: found more than a skin has, expected at most {geometry.height_max_mm:g} mm"
        )
    labels = labels_by_cell(cloud.points_mm, cloud.labels, grid, geometry)
    # A point at the disc's edge may round into a cell outside.
    labels[np.isnan(height_mm)] = 0
    found = objects_of(labels, height_mm, shear_mm, disc_rays(grid, geometry), geometry)
    made = HeightMap(height_mm, labels > 0, message.row0, message.col0, message.step_px)
    return (made, (), 0.0) if found is None else (made, found.described, found.volume_mm3)


def _check_grids(
    height: HeightMessage | None, shear: ShearMessage | None, sigma: SigmaMessage | None
) -> None:
    for other in (shear, sigma):
        if other is not None and (height is None or _grid(other) != _grid(height)):
            raise DecodeError(
                "shear or sigma: found a grid other than the height map's, expected the same grid"
            )


def _grid(message: HeightMessage | ShearMessage | SigmaMessage) -> Grid:
    values = next(
        getattr(message, name)
        for name in ("height_mm", "shear_mm", "sigma_mm")
        if hasattr(message, name)
    )
    rows, cols = values.shape[:2]
    return Grid(rows, cols, message.row0, message.col0, message.step_px)


def _untouched(last: HeightMap) -> HeightMap:
    """A height map of 0 on the grid of the last map received; empty before the first."""
    # Without contact the daemon sends no height, but the disc stays where it was.
    zero_mm = np.where(np.isnan(last.height_mm), np.float32(np.nan), np.float32(0))
    return HeightMap(zero_mm, np.zeros(zero_mm.shape, np.bool_), last.row0, last.col0, last.step_px)


def _touch_of(contact: Contact, numbers: TouchNumbers | None) -> Touch | None:
    """The touch that belongs to a contact's frame; None if there is none."""
    if (
        numbers is None
        or numbers.seq != contact.seq
        or numbers.touch is None
        or numbers.touch_sigma is None
    ):
        return None
    return Touch(numbers.touch, numbers.touch_sigma, _reason(numbers.reason_code, numbers.reason))


def _reason(code: str, text: str = "") -> Reason | None:
    """The reason for a code, None if empty; the code serves as the text if none is published."""
    if not code:
        return None
    # A newer daemon may have codes that we do not know.
    known = next((reason for reason in ReasonCode if reason.value == code), None)
    return Reason(known or ReasonCode.DECODE, text or code)
