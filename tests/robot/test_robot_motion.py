"""What is heard of a robot whose times are in another unit."""

from __future__ import annotations

import pytest

from tacshade_edge.reasons import ReasonCode
from tacshade_edge.robot.pose import PoseSample
from tacshade_edge.robot.robot_motion import (
    ClockExchanged,
    PoseHeard,
    RobotMotion,
    RobotRestarted,
)
from tacshade_edge.robot.verbs import rate_text

S = 10**9
POSE = (1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0)


def hear(motion: RobotMotion, since_ns: int, ns_per_tick: float) -> None:
    """Four seconds of poses, and a SYNC with each tenth."""
    for k in range(200):
        at_ns = since_ns + k * S // 50
        stamp = round(at_ns / ns_per_tick)
        motion.hear(PoseHeard(PoseSample(None, stamp, POSE), at_ns))
        if k % 10 == 0:
            motion.hear(ClockExchanged(stamp, at_ns, at_ns + 1000, None))


@pytest.mark.parametrize(
    ("ns_per_tick", "said"),
    [
        (1e9, "CLOCK rate=1e-09 unit=s expected=ns"),
        (1e6, "CLOCK rate=1e-06 unit=ms expected=ns"),
        (1e3, "CLOCK rate=0.001 unit=us expected=ns"),
        (100, "CLOCK rate=0.01 unit=100ns expected=ns"),
        (1e-3, "CLOCK rate=1000 unit=ps expected=ns"),
        (1 / 300, "CLOCK rate=300 unit=- expected=ns"),
        (-1.0, "CLOCK rate=-1 unit=- expected=ns"),
    ],
)
def test_a_robot_whose_times_are_no_ns_has_no_clock_and_is_told_why(
    ns_per_tick: float, said: str
) -> None:
    motion = RobotMotion()
    hear(motion, 10**13, ns_per_tick)
    state = motion.state()
    assert state.suspected is not None
    assert rate_text(state.suspected) == said
    assert state.mode == "none"
    assert state.reason is not None
    assert state.reason.code is ReasonCode.CLOCK_UNIT
    assert motion.at(10**13 + 3 * S) is None
    # Corrected in its next run.
    motion.hear(RobotRestarted())
    hear(motion, 2 * 10**13, 1)
    assert motion.state().suspected is None
    assert motion.at(2 * 10**13 + 3 * S) is not None


def test_a_time_that_is_sent_again_and_again_is_said() -> None:
    motion = RobotMotion()
    for k in range(100):
        motion.hear(PoseHeard(PoseSample(None, S, POSE), 10**13 + k * S // 10))
    reason = motion.state().reason
    assert reason is not None
    assert reason.code is ReasonCode.CLOCK_STANDS
