"""What is published of a frame, the health and the preview."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.painted_sensor import touched_depth_mm
from support.published_sensor import bump, unmeasured
from tacshade_edge.daemon.active_profile import ActiveProfile
from tacshade_edge.daemon.live_recorder import LiveRecorder
from tacshade_edge.daemon.reference_in_use import References
from tacshade_edge.mqtt.publishing import WIDTH_PX, ContactEvents, HealthReport, Preview, Publisher
from tacshade_edge.pipeline.ledger import FrameLedger, FrameOutcome, Timings
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.robot.robot import Robot
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.stitching.session_worker import Sessions
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction, Slip
from tacshade_edge.wire import binary
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.sensor_topics import ContactEvent
from tacshade_edge.wire.stamped_jpeg import capture_wall_ns
from tacshade_edge.wire.topics import decode_contact_event

PERIOD_NS = 20_000_000  # 50 frames per second


def ignore(*_: object) -> None:
    """Of what a test has no use for."""


class Played:
    """What the publisher offered for a run of pictures."""

    def __init__(
        self,
        calibration: Calibration,
        images: list[Any],
        wanted: tuple[str, ...] = ("height", "cloud", "contact"),
    ) -> None:
        self.offers: list[tuple[str, bytes, int]] = []
        settled: dict[int, FrameOutcome] = {}
        publisher = Publisher(
            lambda stream, payload, seq: self.offers.append((stream, payload, seq)),
            lambda topic, payload: pytest.fail(f"{topic}: {payload!r}"),
            settled.__setitem__,
            lambda stream: stream in wanted,
        )
        publisher.fps = 12.5
        reconstructor = make_reconstructor(calibration, PROFILES["balanced"])
        for seq, image in enumerate(images):
            frame = Frame(seq, seq * PERIOD_NS, 0, image)
            result = reconstructor.step(frame, need=publisher.need())
            publisher.see(FrameResult(frame, calibration, result))
        self.outcomes = [settled.pop(seq, None) for seq in range(len(images))]
        assert not settled

    def seqs(self, stream: str) -> list[int]:
        return [seq for s, _, seq in self.offers if s == stream]

    def decoded(self, stream: str) -> list[Any]:
        return [binary.decode(payload) for s, payload, _ in self.offers if s == stream]


def test_contact_is_published_with_every_frame_and_its_end_once(
    calibration: Calibration, pictures: Any
) -> None:
    free, touched = pictures.free, pictures.touched
    played = Played(calibration, [free, free, touched, touched, free, free, free, touched])
    assert played.seqs("height") == [2, 3, 4, 7]
    assert played.seqs("cloud") == [2, 3, 7]
    assert played.outcomes == ["without_contact"] * 2 + [None] * 3 + ["without_contact"] * 2 + [
        None
    ]
    first, _, release, _ = played.decoded("height")
    assert (first.contact, first.seq, first.calibration_crc32) == (True, 2, calibration.crc32)
    assert np.nanmax(first.height_mm) == pytest.approx(touched_depth_mm(), abs=0.001)
    assert (release.contact, release.invalid) == (False, False)
    assert set(release.height_mm[release.height_mm == release.height_mm]) == {0.0}


def test_contact_numbers_come_at_10_hz_without_contact_and_at_every_change(
    calibration: Calibration, pictures: Any
) -> None:
    played = Played(
        calibration, [pictures.free] * 12 + [pictures.touched] * 2 + [pictures.free] * 7
    )
    assert played.seqs("contact") == [0, 5, 10, 12, 13, 14, 19]
    numbers = [json.loads(payload) for s, payload, _ in played.offers if s == "contact"]
    assert [n["contact"] for n in numbers] == [0, 0, 0, 1, 1, 0, 0]
    assert all(n["fps"] == 12.5 for n in numbers)


def test_an_invalid_frame_ends_a_contact_with_a_flag_and_is_silent_after(
    calibration: Calibration, pictures: Any
) -> None:
    played = Played(
        calibration, [pictures.touched, pictures.black, pictures.black, pictures.touched]
    )
    assert played.seqs("height") == [0, 1, 3]
    assert played.outcomes == [None, None, "invalid", None]
    assert [(h.contact, h.invalid) for h in played.decoded("height")] == [
        (True, False),
        (False, True),
        (True, False),
    ]


def test_an_output_that_nobody_wants_is_left_out_but_for_begin_and_end_of_a_contact(
    calibration: Calibration, pictures: Any
) -> None:
    images = [pictures.free] * 2 + [pictures.touched] * 3 + [pictures.free] * 7
    only_contact = Played(calibration, images, ("contact",))
    assert only_contact.seqs("height") == [2, 5]
    assert only_contact.seqs("cloud") == [2]
    assert only_contact.seqs("contact") == [0, 2, 3, 4, 5, 10]
    assert only_contact.outcomes == ["without_contact"] * 2 + [
        None,
        "unasked",
        "unasked",
        None,
        *["without_contact"] * 6,
    ]
    only_height = Played(calibration, images, ("height",))
    assert only_height.seqs("height") == [2, 3, 4, 5]
    assert only_height.seqs("cloud") == [2]
    assert only_height.seqs("contact") == [2, 5]


def test_shear_is_asked_for_while_it_has_a_subscriber_or_always() -> None:
    def need(*wanted: str, always: bool = False) -> Need:
        return Publisher(ignore, ignore, ignore, lambda stream: stream in wanted, always).need()

    assert need() is Need.CONTACT
    assert need("contact") is need("height") is need("cloud") is Need.DEPTH
    assert need("shear") is need("shear", "height") is need(always=True) is Need.SHEAR
    assert need("sigma") is need("sigma", "height") is Need.SIGMA
    assert need("touch") is need("touch", "shear", "height") is Need.TOUCH
    assert need("shear", "sigma") is need("sigma", always=True) is Need.SHEAR | Need.SIGMA


def test_a_touch_goes_out_while_it_has_a_subscriber_and_once_more_at_release(
    calibration: Calibration, pictures: Any
) -> None:
    images = [pictures.free, pictures.touched, pictures.touched, pictures.black, pictures.free]
    played = Played(calibration, images, ("touch",))
    assert played.seqs("touch") == [1, 2, 3, 4]
    first, _, unknown, released = [
        json.loads(payload) for stream, payload, _ in played.offers if stream == "touch"
    ]
    assert first["touch"]["depth_mm"] == pytest.approx(touched_depth_mm(), abs=0.001)
    assert first["touch"].keys() == first["touch_sigma"].keys()
    ends = [(n["touch"], n["touch_sigma"], n["reason_code"]) for n in (unknown, released)]
    assert ends == [(None, None, "black"), (None, None, "")]
    assert Played(calibration, images, ("height", "shear")).seqs("touch") == []


def test_a_slip_is_reported_once_at_its_onset(calibration: Calibration, pictures: Any) -> None:
    events: list[dict[str, Any]] = []

    def report(topic: str, payload: bytes) -> None:
        assert topic == "event/slip"
        events.append(json.loads(payload))

    publisher = Publisher(ignore, report, ignore)
    frame = Frame(0, 0, 0, pictures.touched)
    result = make_reconstructor(calibration, PROFILES["fast"]).step(frame)
    one = replace(result.objects[0], id=7)
    for seq, (slip, other) in enumerate(
        (
            (Slip.STICK, None),
            (Slip.FULL, None),
            (Slip.FULL, Slip.FULL),
            (Slip.PARTIAL, Slip.FULL),
            (Slip.FULL, None),
        )
    ):
        objects = [replace(one, slip=slip, slip_mm_s=20.0)]
        if other is not None:
            objects.append(replace(one, label=2, id=8, slip=other, slip_mm_s=9.0))
        publisher.see(
            FrameResult(frame, calibration, replace(result, seq=seq, objects=tuple(objects)))
        )
    assert [(event["seq"], event["id"], event["slip_mm_s"]) for event in events] == [
        (1, 7, 20.0),
        (2, 8, 9.0),
        (4, 7, 20.0),
    ]
    assert (events[0]["x_mm"], events[0]["y_mm"]) == pytest.approx(one.centroid_mm[:2])


def test_a_contact_begins_goes_on_and_ends(calibration: Calibration, pictures: Any) -> None:
    sent: list[ContactEvent] = []
    events = ContactEvents(lambda topic, payload: sent.append(decode_contact_event(payload)))
    free, touched = (
        make_reconstructor(calibration, PROFILES["fast"]).step(Frame(0, 0, 0, image))
        for image in (pictures.free, pictures.touched)
    )
    slides = replace(
        touched, objects=(replace(touched.objects[0], slip=Slip.FULL, depth_max_mm=9.0),)
    )

    def see(t_ms: int, result: Reconstruction | None) -> None:
        frame = Frame(0, t_ms * 1_000_000, 7, pictures.free)
        events.see(FrameResult(frame, calibration, result))

    for t_ms, result in (
        (0, free),
        (50, None),
        (100, touched),
        (120, free),
        (200, slides),
        (1000, touched),
        (1050, None),
        (1200, None),
        (1240, free),
        (1300, free),
        (1400, free),
        (1500, touched),
    ):
        see(t_ms, result)
    times = [(one.type, one.id, one.t_ns, one.start_ns, one.end_ns) for one in sent]
    assert [(kind, which, *(t and t // 1_000_000 for t in ts)) for kind, which, *ts in times] == [
        ("new", 1, 50, 50, None),
        ("update", 1, 1050, 50, None),
        ("end", 1, 1300, 50, 1200),
        ("new", 2, 1500, 1500, None),
    ]
    assert (sent[0].depth_max_mm, sent[0].objects, sent[0].slip, sent[0].wall_ns) == (
        None,
        None,
        None,
        7,
    )
    assert (
        (sent[1].depth_max_mm, sent[1].slip, sent[1].objects)
        == (sent[2].depth_max_mm, 2, 1)
        == (9.0, 2, 1)
    )
    assert sent[3].volume_mm3 == pytest.approx(touched.volume_mm3)
    assert (sent[3].depth_max_mm, sent[3].slip) == (touched.objects[0].depth_max_mm, None)


def shown(observer: FrameObserver, calibration: Calibration, *results: Reconstruction) -> None:
    """Let an observer see results, one every `PERIOD_NS`."""
    for seq, result in enumerate(results):
        frame = Frame(seq, seq * PERIOD_NS, 0, np.zeros((2, 2), np.uint8))
        made = replace(result, seq=seq, t_ns=frame.t_ns)
        observer.see(FrameResult(frame, calibration, made))


def test_a_touch_of_unknown_depth_is_published_when_it_begins_and_ends_and_at_10_hz(
    calibration: Calibration,
) -> None:
    offers: list[tuple[str, bytes, int]] = []
    settled: dict[int, FrameOutcome] = {}
    publisher = Publisher(lambda *offer: offers.append(offer), ignore, settled.__setitem__)
    free, lost, pressed = bump(0, 0.0, 0, 0, 8), unmeasured(0), bump(0, 2.0, 236, 328, 8)
    shown(publisher, calibration, free, *[lost] * 7, pressed, lost, free)
    sent = {
        stream: [(seq, payload) for name, payload, seq in offers if name == stream]
        for stream in ("height", "contact", "touch")
    }
    heights = [binary.decode(payload) for _, payload in sent["height"]]
    assert [(h.seq, h.contact, h.touched, h.degraded) for h in heights] == [
        (1, False, True, True),
        (8, True, False, False),
        (9, False, True, True),
        (10, False, False, False),
    ]
    assert [seq for seq, _ in sent["contact"]] == [0, 1, 6, 8, 9, 10]
    touched = {seq: json.loads(payload)["touched"] for seq, payload in sent["contact"]}
    assert [seq for seq, answer in touched.items() if answer] == [1, 6, 9]
    reasons = {seq: json.loads(payload)["reason_code"] for seq, payload in sent["touch"]}
    assert reasons == {1: "touch_unmeasured", 9: "touch_unmeasured", 10: ""}
    assert settled == dict.fromkeys((0, *range(2, 8)), "without_contact")


def test_a_touch_of_unknown_depth_continues_a_contact_and_begins_one_if_it_lasts(
    calibration: Calibration,
) -> None:
    sent: list[ContactEvent] = []
    events = ContactEvents(lambda _, payload: sent.append(decode_contact_event(payload)))
    free, lost, pressed = bump(0, 0.0, 0, 0, 8), unmeasured(0), bump(0, 2.0, 236, 328, 8)
    shown(events, calibration, free, lost, *[free] * 7)
    assert sent == []  # one frame alone
    shown(events, calibration, pressed, *[lost] * 20, pressed, *[free] * 7)
    assert [(one.type, one.id, one.end_ns) for one in sent] == [
        ("new", 1, None),
        ("end", 1, 21 * PERIOD_NS),
    ]
    sent.clear()
    shown(events, calibration, free, *[lost] * 7, *[free] * 7)
    began, ended = sent
    assert (began.type, began.t_ns, began.start_ns) == ("new", 6 * PERIOD_NS, PERIOD_NS)
    assert {one.depth_max_mm for one in sent} == {one.objects for one in sent} == {None}
    assert (ended.type, ended.end_ns) == ("end", 7 * PERIOD_NS)


def test_frames_with_a_touch_of_unknown_depth_are_counted(calibration: Calibration) -> None:
    health = HealthReport(FrameLedger(), Timings())
    shown(health, calibration, bump(0, 2.0, 236, 328, 8), unmeasured(1), unmeasured(2))
    assert health.snapshot(0, {})["touched_frames"] == 2


DOCUMENT = Path(__file__).parents[2] / "docs/reference/mqtt/health.md"


def test_rates_are_between_two_snapshots() -> None:
    ledger = FrameLedger()
    health = HealthReport(ledger, Timings())
    ends: list[FrameOutcome] = ["published", "published", "without_contact", "unasked", "invalid"]
    for seq, end in enumerate(ends):
        ledger.captured(seq)
        ledger.settle(seq, end)
    first = health.snapshot(7, {"connects": 1})
    assert first["source_dropped"] == 7
    assert first["mqtt"] == {"connects": 1}
    assert first["frames"]["captured"] == 5
    assert first["latency_ms"] is None
    # one interval, so the rates have the ratio of the counts; they are rounded
    rates = [first[name] / first["capture_fps"] for name in ("delivered_fps", "published_fps")]
    assert [round(rate, 2) for rate in rates] == [0.8, 0.4]
    second = health.snapshot(7, {})
    assert (second["capture_fps"], second["delivered_fps"], second["published_fps"]) == (0, 0, 0)


def test_every_key_is_documented() -> None:
    section = DOCUMENT.read_text(encoding="utf-8").partition("## Health\n")[2].partition("\n## ")[0]
    documented = {
        name
        for row in re.findall(r"^\| (`.*?) \|", section, re.MULTILINE)
        for name in re.findall("`(.+?)`", row)
    }
    timings = Timings()
    timings.add({"wait": 1.0, "latency": 2.0})
    message = json.loads(encode_json(HealthReport(FrameLedger(), timings).snapshot(0, {})))
    reported = {
        each.health_key for each in (Robot, Sessions, References, LiveRecorder, ActiveProfile)
    }
    assert set(message) | reported == documented
    assert message["latency_ms"] == {"p50": 2.0, "p99": 2.0}
    assert message["stages_ms"] == {"wait": {"p50": 1.0, "p99": 1.0}}
    for name in message["frames"]:
        assert f"`{name}`" in section


class Link:
    """A broker with, or without, somebody who looks."""

    def __init__(self) -> None:
        self.connected = True
        self.listened = True
        self.offered: list[tuple[str, bytes, int]] = []

    def has_listener(self, stream: str) -> bool:
        return self.listened

    def offer(self, *payload: Any) -> None:
        self.offered.append(payload)


def test_the_newest_frame_goes_out_once_even_of_a_contact_whose_depth_nobody_needed(
    pictures: Any,
) -> None:
    link = Link()
    preview = Preview(link)  # type: ignore[arg-type]
    preview.publish()
    assert link.offered == []
    for seq in (3, 4):
        preview.see(FrameResult(Frame(seq, 0, 10 * seq, pictures.touched), None, None))
    for away, alone in ((True, False), (False, True), (False, False), (False, False)):
        link.connected, link.listened = not away, not alone
        preview.publish()
    ((stream, jpeg, seq),) = link.offered
    assert (stream, seq, capture_wall_ns(jpeg)) == ("preview", 4, 40)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED).shape == (
        240,
        WIDTH_PX,
    )
