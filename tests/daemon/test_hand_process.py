"""What a sensor reports to its hand, and over which line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from tacshade_edge.daemon.hand_process import PERIOD_NS, FingerReporter, Lines
from tacshade_edge.errors import DecodeError
from tacshade_edge.pipeline.observer import FrameResult, SourceState
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import shift
from tacshade_edge.settings import Settings
from tacshade_edge.types import Frame, HeightMap, Need, ObjectCloud, Reconstruction, TouchedObject
from tacshade_edge.wire.hand_topics import Finger


@pytest.fixture
def lines() -> Iterator[Lines]:
    made = Lines(["thumb", "index"])
    yield made
    for name, finger in made.fingers.items():
        finger.sock.close()
        made.hand[name].close()


def test_what_a_finger_reports_comes_from_that_finger_in_order(lines: Lines) -> None:
    for seq in range(3):
        lines.fingers["index"].report(Finger(state="free", seq=seq))
    assert lines.take("thumb") is None
    taken = [lines.take("index") for _ in range(4)]
    assert [finger and finger.seq for finger in taken] == [0, 1, 2, None]


def test_a_hand_that_reads_nothing_keeps_no_finger_waiting_and_harms_no_other(lines: Lines) -> None:
    for seq in range(2000):
        lines.fingers["thumb"].report(Finger(state="free", seq=seq))
    lines.fingers["index"].report(Finger(state="contact"))
    assert lines.take("index") == Finger(state="contact")
    taken = 0
    while lines.take("thumb"):
        taken += 1
    assert 1 <= taken < 2000


def test_a_process_that_ended_is_reported_for(lines: Lines) -> None:
    lines.end("thumb")
    lines.end("hand/left")  # the hand's own is none of them
    assert lines.take("thumb") == Finger(state="away", reason_code="daemon_stopped")


def test_bytes_that_are_no_finger_are_refused(lines: Lines) -> None:
    sock = lines.fingers["thumb"].sock
    for sent in (b"x", b"{}", b'{"state": "contact", "reason_code": "' + bytes(40_000)):
        sock.send(sent)
        with pytest.raises(DecodeError, match=r"^a finger: "):
            lines.take("thumb")


class Rig:
    def __init__(self, lines: Lines) -> None:
        self.lines = lines
        self.lines.want(wanted=True)
        self.finger = FingerReporter(self.lines.fingers["thumb"], shift(1, 2, 3))

    def see(self, result: Reconstruction | None) -> None:
        frame = Frame(0, 0, 0, np.zeros((1, 1), np.uint8))
        self.finger.see(FrameResult(frame, None, result))

    def reported(self) -> list[Finger]:
        return list(iter(lambda: self.lines.take("thumb"), None))


@pytest.fixture
def rig(lines: Lines) -> Rig:
    return Rig(lines)


def result(
    t_ns: int, *, contact: bool = False, reason: Reason | None = None, touched: bool = False
) -> Reconstruction:
    height = np.zeros((1, 1), np.float32)
    grid = HeightMap(height, height > 0, 0, 0, 1)
    cloud = ObjectCloud(np.zeros((1, 3), np.float32), np.ones(1, np.uint16))
    objects = (TouchedObject(1, (0, 0, 20), (0, 0, 0), 1.0, 2.0),) if contact else ()
    valid = reason is None
    made = Reconstruction(
        7, t_ns, 0, "fast", valid, reason, contact, False, None, grid, cloud, objects
    )
    return replace(made, touched=touched)


def test_depth_is_asked_for_while_somebody_listens(rig: Rig) -> None:
    assert rig.finger.need() == Need.DEPTH
    rig.lines.want(wanted=False)
    assert rig.finger.need() == Need.CONTACT


def test_every_frame_in_contact_is_reported_in_the_hands_frame(rig: Rig) -> None:
    for t_ns in (0, 1, 2):
        rig.see(result(t_ns, contact=True))
    reports = rig.reported()
    assert [f.t_ns for f in reports] == [0, 1, 2]
    assert {f.objects[0].centroid_mm for f in reports} == {(1.0, 2.0, 23.0)}


def test_without_contact_it_reports_ten_times_a_second(rig: Rig) -> None:
    for t_ns in range(0, 3 * PERIOD_NS, PERIOD_NS // 5):
        rig.see(result(t_ns))
    assert [f.t_ns for f in rig.reported()] == [0, PERIOD_NS, 2 * PERIOD_NS]


def test_a_touch_of_unknown_depth_is_reported_when_it_begins_and_ends(rig: Rig) -> None:
    for t_ns in range(6):
        rig.see(result(t_ns, touched=2 <= t_ns < 4))
    found = [(f.t_ns, f.state, f.touched) for f in rig.reported()]
    assert found == [(0, "free", False), (2, "free", True), (4, "free", False)]


def test_every_change_is_reported_at_once(rig: Rig) -> None:
    torn = Reason(ReasonCode.TORN, "torn")
    for t_ns, more in enumerate(
        ({}, {"contact": True}, {}, {}, {"reason": torn}, {"reason": torn}, {})
    ):
        rig.see(result(t_ns, **more))  # type: ignore[arg-type]
    states = [(f.t_ns, f.state, f.reason_code) for f in rig.reported()]
    assert states == [
        (0, "free", ""),
        (1, "contact", ""),
        (2, "free", ""),
        (4, "away", "torn"),
        (6, "free", ""),
    ]


def test_nothing_is_reported_while_nobody_listens_and_all_of_it_when_somebody_does(
    rig: Rig,
) -> None:
    rig.see(result(0))
    rig.lines.want(wanted=False)
    rig.see(result(1))
    rig.see(None)
    rig.lines.want(wanted=True)
    rig.see(None)  # asked for before
    rig.see(result(2))
    assert [f.t_ns for f in rig.reported()] == [0, 2]


def test_a_camera_that_is_gone_is_reported_whoever_listens(rig: Rig) -> None:
    rig.lines.want(wanted=False)
    rig.finger.source_changed(SourceState("away", Reason(ReasonCode.LOST, "gone")))
    assert rig.reported() == [Finger(state="away", reason_code="lost")]


def test_a_new_place_in_the_hand_holds_from_the_next_frame_on(rig: Rig) -> None:
    rig.finger.settings_changed(Settings(hand_T_sensor=(0, 0, -20, 1, 0, 0, 0)))
    rig.see(result(0, contact=True))
    (report,) = rig.reported()
    assert report.objects[0].centroid_mm == (0.0, 0.0, 0.0)
