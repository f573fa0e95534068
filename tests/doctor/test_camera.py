"""What is said of frames; nodes, formats and busy cameras are looked at in the guest (tests/guest/test_doctor.py)."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tacshade_edge.doctor.camera import check_frames, check_other_source, check_picture
from tacshade_edge.doctor.capture import Captured
from tacshade_edge.doctor.finding import Finding
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.settings import V4l2
from tools.testbed.painted_sensor import BLACK, FREE

LOCKED = {
    "time_stamps": "kernel",
    **{"exposure": "locked at 157", "exposure_lock": "locked"},
    **{"white_balance": "locked", "white_balance_lock": "locked"},
}


def frames(fps: float = 30, **changes: Any) -> Captured:
    t_ns = tuple(round(1e9 + k * 1e9 / fps) for k in range(30))
    late = tuple(t + 20_000_000 for t in t_ns)
    values = {"images": (FREE,), "t_ns": t_ns, "arrived_ns": late, "described": LOCKED} | changes
    return Captured(**values)


def judged(machine: Any, captured: Captured) -> dict[str, Finding]:
    findings = check_frames(V4l2(), captured, machine, "")
    assert all(bool(finding.fix) == (finding.state != "ok") for finding in findings)
    return {finding.check: finding for finding in findings if finding.state != "ok"}


def test_a_good_camera(machine: Any) -> None:
    assert judged(machine, frames()) == {}
    assert judged(machine, frames(dropped=1)) == {}, "a stream's start may cost a frame"
    found = [finding.found for finding in check_frames(V4l2(), frames(), machine, "")]
    assert found == [
        "30.0 frames/s, 30 requested",
        "time stamps: kernel; frames up to 20 ms old",
        "exposure: locked at 157",
        "white balance: locked",
        "160x120 px, mean grey 64, standard deviation 68",
    ]


@pytest.mark.parametrize(
    ("captured", "check", "said"),
    [
        (frames(fps=15), "camera frames", "15.0 frames/s, 30 requested"),
        (frames(dropped=4), "camera frames", "30.0 frames/s, 30 requested, 4 lost"),
        (frames(described=LOCKED | {"time_stamps": "on arrival"}), "camera time", "time stamps: on arrival"),
        (frames(t_ns=(1_000_000_000,) * 30), "camera time", "out of order"),
        (frames(arrived_ns=(4_000_000_000,) * 30), "camera time", "frames up to 3000 ms old"),
        (
            frames(described=LOCKED | {"exposure": "automatic, not locked (157)", "exposure_lock": "automatic"}),
            "camera control",
            "exposure: automatic",
        ),
        (frames(images=(BLACK,)), "picture", "black: mean grey level 0"),
        (
            Captured(
                error=Reason(ReasonCode.STALLED, "camera /dev/video0: no frame within 2.0 s: the camera has stalled")
            ),
            "camera frames",
            "no frame within",
        ),
    ],
)
def test_what_is_wrong_is_said(machine: Any, captured: Captured, check: str, said: str) -> None:
    assert said in judged(machine, captured)[check].found


@pytest.mark.parametrize(
    ("image", "reason", "fix"),
    [
        (np.full((120, 160), 255, np.uint8), "saturated: 100 %", "dim"),
        (np.full((120, 160), 90, np.uint8), "no contrast", "focus"),
        (np.zeros((120, 160, 3), np.uint8), "black", "light on"),
    ],
)
def test_a_picture_that_shows_nothing(image: Any, reason: str, fix: str) -> None:
    finding = check_picture(image)
    assert finding.state == "fault"
    assert finding.found.startswith(reason)
    assert fix in finding.fix


def test_other_sources() -> None:
    assert [f.state for f in check_other_source(frames(), 30.0)] == ["ok", "ok"]
    assert check_other_source(frames(fps=5), 30.0)[0].state == "warning"
    (gone,) = check_other_source(Captured(error=Reason(ReasonCode.CONFIG, "x: found nothing")), 30.0)
    assert (gone.state, gone.found) == ("fault", "x: found nothing")
    (empty,) = check_other_source(Captured(), 30.0)
    assert empty.state == "fault"
    single = frames(images=(FREE,), t_ns=(1,), arrived_ns=(2,), described={"path": "a.png"})
    assert check_other_source(single, 30.0)[0].found == "a.png: 1 frames"
