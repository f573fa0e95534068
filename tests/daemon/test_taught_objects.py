"""Which taught objects touch: `event/object`, the robot's event, and the file
that `teach` writes.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support.painted_sensor import FREE, painted_calibration
from support.published_sensor import bump, unmeasured
from tacshade_edge.calibration.files import objects_file
from tacshade_edge.daemon.taught_objects import SETTLED_NS, ObjectEvents, TaughtObjects
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.types import Frame, KnownObject, Need, TouchedObject

KNOWN = {"fast": (KnownObject("nut", np.zeros((1, 3), np.float32)),)}
STEP_NS = SETTLED_NS // 2
OBJECT = TouchedObject(1, (0.5, -1.5, 17.0), (4.0, 4.0, 1.0), 2.0, 50.0)


class Seen:
    """What the observer reports of frames, each with the names of its objects by label; None if
    something touches, but its depth is unknown.
    """

    def __init__(
        self, frames: Iterable[dict[int, str | None] | None], *, taught: bool = True
    ) -> None:
        self.published: list[tuple[str, bytes]] = []
        self.told: list[str] = []
        events = ObjectEvents(
            lambda *event: self.published.append(event), lambda _: True, self.told.append
        )
        calibration = replace(painted_calibration(), known=KNOWN if taught else {})
        for seq, named in enumerate(frames):
            objects = tuple(
                replace(OBJECT, label=label, name=name, probability=name and 0.91234)
                for label, name in (named or {}).items()
            )
            result = bump(seq, 2.0, 100, 100) if named is not None else unmeasured(seq)
            made = replace(result, t_ns=seq * STEP_NS, objects=objects)
            events.see(FrameResult(Frame(seq, 0, 0, FREE), calibration, made))
        self.needs = events.need()

    @property
    def reported(self) -> list[tuple[int, str]]:
        return [(event["seq"], event["name"]) for event in map(json.loads, self.payloads)]

    @property
    def payloads(self) -> list[bytes]:
        assert {topic for topic, _ in self.published} <= {"event/object"}
        return [payload for _, payload in self.published]


def test_a_name_is_reported_once_it_has_settled() -> None:
    seen = Seen([{1: "nut"}] * 5)
    assert [json.loads(payload) for payload in seen.payloads] == [
        {
            "name": "nut",
            "probability": 0.912,
            "label": 1,
            "t_ns": SETTLED_NS,
            "seq": 2,
            "wall_ns": json.loads(seen.payloads[0])["wall_ns"],
        }
    ]
    assert seen.told == [f"OBJECT 2 {SETTLED_NS} nut 0.912"]


def test_each_contact_and_each_change_is_reported() -> None:
    nut, key = {1: "nut"}, {1: "key"}
    assert Seen([nut, nut, nut, {}, nut, nut, nut]).reported == [(2, "nut"), (6, "nut")]
    assert Seen([nut, nut, nut, key, nut, key, key, key]).reported == [(2, "nut"), (7, "key")]
    assert Seen([nut, key, nut, key, nut, key]).reported == []
    both: dict[int, str | None] = {1: "nut", 2: "key"}
    assert Seen([both] * 3).reported == [(2, "nut"), (2, "key")]


def test_a_frame_of_unknown_depth_ends_no_contact() -> None:
    seen = Seen([{1: "nut"}, None, {1: "nut"}, {1: "nut"}, None, {1: "nut"}, {1: "nut"}])
    assert seen.reported == [(2, "nut")]


def test_unknown_objects_are_not_reported() -> None:
    assert Seen([{1: None}] * 5).reported == []
    assert Seen([{1: "nut"}] * 3 + [{1: None}] * 3 + [{1: "nut"}] * 3).reported == [(2, "nut")]


def test_depth_is_asked_for_only_where_somebody_wants_names_of_something_taught() -> None:
    assert Seen([{}]).needs is Need.DEPTH
    assert Seen([{}], taught=False).needs is Need.CONTACT
    taught = FrameResult(Frame(0, 0, 0, FREE), replace(painted_calibration(), known=KNOWN), None)
    for wanted, need in (("event/object", Need.DEPTH), ("height", Need.CONTACT)):
        events = ObjectEvents(lambda *_: None, lambda stream, wanted=wanted: stream == wanted)
        events.see(taught)
        assert events.need() is need


def test_the_file_is_read_again_when_it_changes(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = objects_file.path_beside(tmp_path / "cal.npz")
    taught = TaughtObjects(str(tmp_path / "cal.npz"))
    assert taught.changed() is None
    objects_file.save(path, KNOWN)
    found = taught.changed()
    assert found is not None
    assert [each.name for each in found["fast"]] == ["nut"]
    assert taught.changed() is None
    os.unlink(path)
    assert taught.changed() == {}
    path.write_bytes(b"PK")
    with caplog.at_level(logging.WARNING):
        assert taught.changed() is None
        assert taught.changed() is None
    (record,) = caplog.records
    assert "the objects stay as they were" in record.getMessage()
