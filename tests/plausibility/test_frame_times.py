"""Times of frames of any camera, in ns and in other units."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.plausibility.frame_times import judge_steps, judge_time_cell
from tacshade_edge.plausibility.suspicions import SuspicionCode
from tacshade_edge.plausibility.units import TIMES, UnitName

PERIODS_S = st.floats(1 / 2000, 30 * 86400)
JITTERS = st.lists(st.floats(0.5, 1.5), min_size=1, max_size=40)


@given(PERIODS_S, JITTERS, st.integers(0, 10**15))
def test_no_camera_is_suspected(period_s: float, jitter: list[float], gap_ns: int) -> None:
    steps = [round(period_s * 1e9 * part) for part in jitter]
    assert judge_steps(steps) is None
    # A recording that paused.
    assert judge_steps([*steps, gap_ns + steps[-1]]) is None


@given(
    st.floats(5, 240),
    JITTERS,
    st.sampled_from(
        [UnitName.MILLISECOND, UnitName.MICROSECOND, UnitName.SECOND, UnitName.HUNDRED_NS]
    ),
)
def test_a_cameras_times_in_a_larger_unit_are_suspected(
    fps: float, jitter: list[float], unit: UnitName
) -> None:
    steps = [round(1e9 / fps / TIMES[unit] * part) for part in jitter]
    found = judge_steps(steps)
    if 1e9 / fps / TIMES[unit] * 1.5 < 100_000:
        assert found is not None
        assert found.code is SuspicionCode.STEPS_TOO_SHORT
        if (
            unit is UnitName.MILLISECOND
            and 15 <= fps <= 60
            and all(0.8 < part < 1.2 for part in jitter)
        ):
            assert "in ms?" in str(found)


def test_nothing_follows_from_one_frame() -> None:
    assert judge_steps([]) is None


@pytest.mark.parametrize(
    ("cell", "code"),
    [
        ("1.20E+10", SuspicionCode.TIME_ROUNDED),
        ("1,2e10", SuspicionCode.TIME_ROUNDED),
        ("12.5", SuspicionCode.TIME_FRACTION),
        ("12", None),
        ("-3", None),
        ("nan", None),
        ("1e999", None),
        ("x", None),
        ("", None),
    ],
)
def test_a_cell_that_a_spreadsheet_wrote(cell: str, code: SuspicionCode | None) -> None:
    found = judge_time_cell(cell)
    assert (found and found.code) is code
