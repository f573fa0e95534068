"""What a running sensor's untouched frames are, and where they say that a touch begins."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.published_sensor import unmeasured
from tacshade_edge.reasons import Reason
from tacshade_edge.sensor.contact.rest import WAYS, Evidence, limits_of
from tacshade_edge.sensor.contact.untouched import (
    ENOUGH_FRAMES,
    FACTOR,
    MEASURED_EVERY,
    MOMENT_S,
    PERIOD_S,
    REST_S,
    UNTOUCHED_FRAMES,
    RestLearner,
    Untouched,
    UntouchedFrames,
    within,
    worth,
)
from tacshade_edge.types import U8, Frame, RestLimits

FPS = 5
TOUCHED = unmeasured(0)
FREE = replace(TOUCHED, touched=False, degraded=None)
CONTACT = replace(FREE, contact=True)
Kind = Callable[[int], str]


class Stream:
    """Frames on the test's clock; the image of each is its number, which its evidence repeats."""

    def __init__(self) -> None:
        self.frames = UntouchedFrames(self._measured)
        self.t = 0
        self._waiting: list[Untouched] = []

    def _measured(self, image: U8) -> tuple[str, Evidence]:
        return "fast", Evidence(float(image[0, 0]), 0.0, 0.0)

    def show(self, kind: Kind, count: int) -> Iterator[Untouched]:
        """Show frames and yield the batches that nothing touched before and after."""
        results = {"free": FREE, "touched": TOUCHED, "contact": CONTACT, "unasked": None}
        for k in range(count):
            self.t += 1
            image: U8 = np.full((2, 2), self.t, np.int32)  # type: ignore[assignment]
            frame = Frame(self.t, round(self.t / FPS * 1e9), 0, image)
            self.frames.see(frame, results[kind(k)])
            taken = self.frames.take()
            assert not isinstance(taken, Reason)
            self._waiting += [taken] if taken else []
            for batch in list(self._waiting):
                untouched = self.frames.untouched_since(batch.end_ns)
                if untouched is not None:
                    self._waiting.remove(batch)
                if untouched:
                    yield batch


def seen(batches: list[Untouched]) -> list[int]:
    """The numbers of the frames whose evidence counts."""
    return [round(one.height_mm) for batch in batches for one in batch.evidence]


def test_some_of_ten_frames_a_minute_are_measured_and_the_first_also_moved() -> None:
    batches = list(Stream().show(lambda k: "free", int(5 * PERIOD_S * FPS)))
    assert len(batches) == 5
    assert {len(batch.images) for batch in batches} == {UNTOUCHED_FRAMES}
    assert {len(batch.evidence) for batch in batches} == {UNTOUCHED_FRAMES // MEASURED_EVERY}
    assert [batch.way for batch in batches] == [0, 1, 2, 3, 0]
    assert all(len(batch.moved) == 1 for batch in batches)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1500), st.integers(1, 100)), max_size=6), st.booleans())
def test_no_frame_near_a_contact_counts(touches: list[tuple[int, int]], asked: bool) -> None:
    def kind(k: int) -> str:
        pressed = any(start <= k < start + count for start, count in touches)
        return ("contact" if asked else "unasked") if pressed else "free"

    counted = seen(list(Stream().show(kind, 1800)))
    pressed = [t + 1 for t in range(1800) if kind(t) != "free"]
    assert all(abs(t - other) >= REST_S * FPS for t in counted for other in pressed)
    if not touches:
        assert counted


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_frames_beyond_the_limits_for_a_moment_count_as_often_as_they_come(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # A fifth of the frames, none of which has neighbours that last longer than a moment.
    beyond = rng.random(20_000) < 0.2
    most = int(MOMENT_S * FPS)
    for k in range(most, len(beyond)):
        beyond[k] &= not beyond[k - most : k].all()
    counted = seen(list(Stream().show(lambda k: "touched" if beyond[k] else "free", len(beyond))))
    assert len(counted) > 250
    share = np.mean([beyond[t - 1] for t in counted])
    assert share == pytest.approx(beyond.mean(), abs=0.12)


def test_a_longer_touch_of_unknown_depth_ends_the_rest_and_never_counts() -> None:
    stream = Stream()
    long = int(MOMENT_S * FPS) + 1

    def kind(k: int) -> str:
        return "touched" if k % int(8 * FPS) < long else "free"

    assert not list(stream.show(kind, 3000))
    assert not list(stream.show(lambda k: "touched", 600))
    assert list(stream.show(lambda k: "free", int((2 * REST_S + 4) * FPS)))


def test_a_touch_soon_after_them_makes_them_void() -> None:
    stream = Stream()
    batch = int((REST_S + 1) * FPS) + UNTOUCHED_FRAMES
    assert not list(stream.show(lambda k: "free", batch))
    assert not list(stream.show(lambda k: "contact", 1))
    assert not list(stream.show(lambda k: "free", int(REST_S * FPS) + 5))


def batch_of(
    evidence: list[Evidence], way: int = 0, moved: list[Evidence] | None = None
) -> Untouched:
    return Untouched([], "fast", tuple(evidence), way, tuple(moved or []), 0)


def drawn(rng: np.random.Generator) -> Evidence:
    return Evidence(0.02 * rng.exponential(), 0.003 * rng.exponential(), 0.01 * rng.random())


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10**6))
def test_limits_come_near_those_of_all_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    everything = [drawn(rng) for _ in range(1500)]
    learner = RestLearner()
    ways: list[list[Evidence]] = [[] for _ in range(WAYS)]
    for k in range(150):
        moved = replace(everything[10 * k], local_change=0.006)
        ways[k % WAYS].append(moved)
        learner.add(batch_of(everything[10 * k : 10 * k + 10 : 2], k % WAYS, [moved]))
    made, wanted = learner.limits(None), limits_of(everything, ways, 1e-4)
    assert made is not None
    assert wanted is not None
    assert made.frames == 750
    assert made.height_mm == pytest.approx(wanted.height_mm, rel=0.35)
    assert made.local_change == pytest.approx(wanted.local_change, rel=0.35)
    assert made.changed_part == wanted.changed_part


FIRST = RestLimits(60, 1e-3, height_mm=0.05, local_change=0.02, changed_part=0.3)


def test_few_frames_give_none_and_old_ones_are_forgotten() -> None:
    learner = RestLearner()
    for k in range(ENOUGH_FRAMES // 5):
        assert learner.limits(FIRST) is None
        learner.add(batch_of([Evidence(0.04 + 0.001 * k, 0.0, 0.0)] * 5))
    before = learner.limits(None)
    assert before is not None
    assert (before.frames, before.false_contacts) == (ENOUGH_FRAMES, 1e-4)
    for _ in range(1000):
        learner.add(batch_of([Evidence(0.01, 0.0, 0.0)] * 5))
    after = learner.limits(None)
    assert after is not None
    assert after.height_mm == 0.02


@given(
    st.floats(0, 10),
    st.floats(-1, 10),
    st.floats(0, 1),
)
def test_no_touch_widens_or_narrows_them_without_bound(
    height_mm: float, local_change: float, changed_part: float
) -> None:
    learner = RestLearner()
    for _ in range(ENOUGH_FRAMES // 5):
        learner.add(batch_of([Evidence(height_mm, local_change, changed_part)] * 5))
    made = learner.limits(FIRST)
    assert made is not None
    assert made.false_contacts == FIRST.false_contacts
    for name in ("height_mm", "local_change", "changed_part"):
        first, now = getattr(FIRST, name), getattr(made, name)
        assert first / FACTOR - 1e-9 <= now <= first * FACTOR + 1e-9


def test_limits_near_zero_have_room_and_small_changes_are_not_worth_it() -> None:
    tiny = replace(FIRST, height_mm=0.0, local_change=-0.001)
    wide = within(replace(FIRST, height_mm=1.0, local_change=1.0), tiny)
    assert (wide.height_mm, wide.local_change) == (pytest.approx(0.02), pytest.approx(0.009))
    assert worth(None, FIRST)
    assert not worth(FIRST, replace(FIRST, height_mm=0.055, frames=900))
    assert worth(FIRST, replace(FIRST, height_mm=0.065))
    assert not worth(tiny, replace(tiny, height_mm=0.003))
