"""Touches that the daemon streams to a robot on a pty."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import count

import numpy as np
import pytest

from support.patience import patience, wait_until
from tacshade_edge.pipeline.observer import FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import cobs_decode, cobs_encode
from tacshade_edge.robot.line import seal
from tacshade_edge.robot.port import SerialPort
from tacshade_edge.robot.robot import Robot
from tacshade_edge.robot.touch_events import TouchEvents
from tacshade_edge.robot.verbs import TouchAsked, object_text
from tacshade_edge.types import Frame, HeightMap, Need, ObjectCloud, Reconstruction, Touch
from tacshade_edge.wire.results import TouchSwitched

NS = 1_000_000_000

FREE = Reconstruction(
    seq=0,
    t_ns=0,
    wall_ns=0,
    profile="fast",
    valid=True,
    reason=None,
    contact=False,
    saturated=False,
    degraded=None,
    height=HeightMap(np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_), 0, 0, 1),
    cloud=ObjectCloud(np.zeros((0, 3), np.float32), np.zeros(0, np.uint16)),
)


def touched(seq: int, depth_mm: float | None, t_ns: int | None = None) -> Reconstruction:
    touch = Touch({"depth_mm": depth_mm}, {"depth_mm": None})
    return replace(
        FREE, seq=seq, t_ns=seq * NS if t_ns is None else t_ns, contact=True, touch=touch
    )


class Bench:
    """The robot's end of a pty, and the daemon's part that serves it."""

    def __init__(self, baud: int = 115200) -> None:
        self.master, self._slave = os.openpty()
        self.robot = Robot(
            SerialPort(os.ttyname(self._slave), baud),
            lambda *_: None,
            dict,
            lambda _: None,
            lambda: self.missing,
            lambda: self.quantities,
        )
        self.missing: Reason | None = None
        self.quantities: Sequence[str] | Reason = ("depth_mm", "force_z_n")
        self._heard = b""
        self._numbers = count(1)

    def __enter__(self) -> Bench:
        self.robot.start()
        wait_until(lambda: "READY" in self.line(), 10, "the port")
        return self

    def __exit__(self, *_: object) -> None:
        self.robot.stop(10)
        os.close(self.master)
        os.close(self._slave)

    def line(self) -> str:
        """The next line or frame without its checksum, read one byte at a time."""
        deadline_s = time.monotonic() + patience(10)
        while time.monotonic() < deadline_s:
            if select.select([self.master], [], [], 0.1)[0]:
                byte = os.read(self.master, 1)
                if byte in b"\n\0" and self._heard:
                    raw, self._heard = self._heard, b""
                    text = cobs_decode(raw)[1:] if byte == b"\0" else raw
                    return text.decode().rpartition("*")[0]
                self._heard += byte
        raise AssertionError(f"no line, only {self._heard!r}")

    def ask(self, text: str, *, binary: bool = False) -> str:
        """The answer to a line that is sent one byte at a time."""
        sealed = seal(f"#{next(self._numbers)} {text}")
        for byte in cobs_encode(b"L" + sealed[:-1]) + b"\0" if binary else sealed:
            os.write(self.master, bytes([byte]))
        return self.line()

    def show(self, result: Reconstruction) -> None:
        self.robot.see(
            FrameResult(Frame(result.seq, result.t_ns, 0, np.zeros((2, 2), np.uint8)), None, result)
        )


@pytest.fixture
def bench() -> Iterator[Bench]:
    with Bench() as made:
        yield made


@pytest.mark.parametrize("binary", [False, True], ids=["ASCII", "BIN"])
def test_each_frame_in_contact_and_one_at_the_end_until_off(bench: Bench, binary: bool) -> None:
    if binary:
        assert bench.ask("MODE BIN") == "OK 1 BIN"
    assert bench.robot.need() == Need.CONTACT
    assert bench.ask("TOUCH ON depth_mm force_z_n", binary=binary).endswith("on=1 rate_hz=60")
    assert bench.robot.need() == Need.TOUCH
    bench.show(FREE)  # nothing ended
    bench.show(replace(FREE, contact=True))  # begun before anybody asked
    bench.show(touched(7, 1.25))
    assert bench.line() == "EVT TOUCH 7 7000000000 depth_mm=1.250 force_z_n=-"
    bench.show(touched(8, None))
    assert bench.line() == "EVT TOUCH 8 8000000000 depth_mm=- force_z_n=-"
    bench.show(replace(FREE, valid=False, reason=Reason(ReasonCode.BLACK, "black")))
    bench.show(replace(FREE, seq=9, t_ns=9 * NS))
    assert bench.line() == "EVT TOUCH 9 9000000000 contact=0 depth_mm=- force_z_n=-"
    bench.show(replace(FREE, seq=10, t_ns=10 * NS))
    bench.show(touched(11, 0.5))
    assert bench.line() == "EVT TOUCH 11 11000000000 depth_mm=0.500 force_z_n=-"
    assert bench.ask("TOUCH OFF", binary=binary).endswith(" on=0")
    assert bench.robot.need() == Need.CONTACT
    bench.show(touched(12, 0.5))
    assert bench.robot.health().items() >= {"touch_events": 4, "touch_dropped": 0}.items()


def test_a_touch_of_unknown_depth_is_an_event_and_no_end(bench: Bench) -> None:
    bench.ask("TOUCH ON depth_mm")
    lost = replace(FREE, touched=True)
    for result, line in (
        (replace(lost, seq=1, t_ns=NS), "EVT TOUCH 1 1000000000 touched=1 depth_mm=-"),
        (touched(2, 1.25), "EVT TOUCH 2 2000000000 depth_mm=1.250"),
        (replace(lost, seq=3, t_ns=3 * NS), "EVT TOUCH 3 3000000000 touched=1 depth_mm=-"),
        (replace(FREE, seq=4, t_ns=4 * NS), "EVT TOUCH 4 4000000000 contact=0 depth_mm=-"),
    ):
        bench.show(result)
        assert bench.line() == line


def test_what_is_refused(bench: Bench) -> None:
    assert (
        bench.ask("TOUCH") == f"ERR 1 ARGS expected {bench.ask('HELP TOUCH').removeprefix('OK 2 ')}"
    )
    assert (
        bench.ask("TOUCH ON depth_mm 0")
        == "ERR 3 ARGS found the RATE 0, expected a whole number of Hz from 1 to 1000"
    )
    assert bench.ask("TOUCH ON depth_mm 500") == (
        "ERR 4 REFUSED found 34500 bytes/s (500 events/s of up to 69 bytes), expected at most "
        "10368 bytes/s (90 % of 115200 baud); use a lower RATE, fewer names or a faster line"
    )
    assert not bench.robot.need()
    bench.missing = Reason(ReasonCode.NOT_CALIBRATED, "not calibrated: do that")
    assert bench.ask("TOUCH ON depth_mm") == "ERR 5 UNCALIBRATED not calibrated: do that"


def test_a_quantity_that_the_calibration_has_not_learnt_is_refused(bench: Bench) -> None:
    bench.quantities = ("depth_mm", "twist_deg")
    assert bench.ask("TOUCH ON depth_mm force_z_n") == (
        "ERR 1 UNAVAILABLE found force_z_n, which this calibration has not learnt, expected one of "
        "depth_mm twist_deg; calibrate --labels learns others"
    )
    bench.quantities = Reason(ReasonCode.TOUCH_NETWORKS, "trained with other networks")
    assert bench.ask("TOUCH ON depth_mm") == "ERR 2 REFUSED trained with other networks"
    assert not bench.robot.need()
    bench.quantities = ("force_z_n",)
    assert bench.ask("TOUCH ON force_z_n") == "OK 3 on=1 rate_hz=60"


def test_a_touch_that_waits_is_replaced_by_a_newer_one() -> None:
    events = TouchEvents(10**7, lambda: None)
    events.switch(TouchAsked(("depth_mm",), 1000))
    for seq in range(1, 4):
        events.observe(touched(seq, 1.0))
    seen = events.take()
    assert seen is not None
    assert (seen.seq, events.take(), events.as_dict()) == (
        3,
        None,
        {"touch_events": 1, "touch_dropped": 2},
    )


def rates(asked_hz: int, frame_hz: float, jitter_s: float = 0.0) -> list[int]:
    """Which frames of 10 s are reported."""
    events, woken = TouchEvents(10**7, lambda: None), []
    assert events.switch(TouchAsked(("depth_mm",), asked_hz)) == TouchSwitched(asked_hz)
    rng = np.random.default_rng(1)
    for k in range(int(10 * frame_hz)):
        events.observe(touched(k, 1.0, int(NS * (5 + k / frame_hz + rng.uniform(0, jitter_s)))))
        if (seen := events.take()) is not None:
            woken.append(seen.seq)
    return woken


@pytest.mark.parametrize(
    ("asked_hz", "frame_hz", "jitter_s", "expected"),
    [
        (60, 60, 0.004, 600),
        (60, 30, 0.004, 300),
        (50, 60, 0.0, 500),
        (30, 60, 0.004, 300),
        (7, 60, 0.004, 70),
        (60, 120, 0, 600),
    ],
)
def test_at_most_so_many_a_second_and_all_of_a_slower_camera(
    asked_hz: int, frame_hz: float, jitter_s: float, expected: int
) -> None:
    assert len(rates(asked_hz, frame_hz, jitter_s)) == pytest.approx(expected, abs=2)


def test_the_robot_hears_what_is_told_it() -> None:
    with Bench() as bench:
        bench.robot.tell(object_text(814, 120_034_567_890, "nut_m8", 0.91234))
        assert bench.line() == "EVT OBJECT 814 120034567890 nut_m8 0.912"
        assert bench.ask("help touch").startswith("OK 1 TOUCH")
