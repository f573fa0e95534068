from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.references import GAP_S, PERIOD_S, REST_S, UNTOUCHED_FRAMES, UntouchedFrames
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Calibration, Frame, Need

FPS = 10
DOUBT = Reason(ReasonCode.GLARE, "glare hides 3 % of the disc")


class Stream:
    """Frames at 10 per second of a clock that the test turns."""

    def __init__(self, reconstructor: Reconstructor) -> None:
        self.frames = UntouchedFrames()
        self.s = 1000.0
        self._reconstructor = reconstructor

    def show(self, image: U8, seconds: float, doubt: Reason | None = None, glance: bool = False) -> None:
        need = Need.CONTACT if glance else Need.SHEAR
        for _ in range(round(seconds * FPS)):
            self.s += 1 / FPS
            frame = Frame(0, round(self.s * 1e9), 0, image)
            result = self._reconstructor.step(frame, need=need)
            self.frames.see(frame, replace(result, degraded=doubt) if result and doubt else result)

    def taken(self) -> int | Reason | None:
        """The number of images, or the doubt."""
        taken = self.frames.take()
        return len(taken) if isinstance(taken, list) else taken


@pytest.fixture
def stream(calibration: Calibration) -> Stream:
    return Stream(make_reconstructor(calibration, PROFILES["fast"]))


BATCH_S = UNTOUCHED_FRAMES / FPS


def test_ten_frames_of_a_sensor_at_rest_once_a_minute(stream: Stream, pictures: Any) -> None:
    stream.show(pictures.free, REST_S)
    assert stream.taken() is None
    stream.show(pictures.free, BATCH_S + 0.2)
    assert stream.taken() == UNTOUCHED_FRAMES
    stream.show(pictures.free, PERIOD_S - 1)
    assert stream.taken() is None
    stream.show(pictures.free, BATCH_S + 1)
    assert stream.taken() == UNTOUCHED_FRAMES
    assert stream.frames.spoiled == 0


def test_none_are_taken_while_the_last_ones_wait(stream: Stream, pictures: Any) -> None:
    stream.show(pictures.free, REST_S + 3 * PERIOD_S)
    first = stream.frames.take()
    assert isinstance(first, list)
    assert stream.frames.take() is None
    stream.show(pictures.free, BATCH_S + 0.2)
    assert stream.taken() == UNTOUCHED_FRAMES


@pytest.mark.parametrize("how", ["touched", "black"])
@pytest.mark.parametrize("glance", [False, True])
def test_a_touch_or_an_invalid_frame_ends_the_rest(stream: Stream, pictures: Any, how: str, glance: bool) -> None:
    stream.show(pictures.free, REST_S + BATCH_S / 2)
    assert stream.frames.at_rest
    stream.show(getattr(pictures, how), 0.1, glance=glance)
    assert (stream.frames.at_rest, stream.frames.spoiled) == (False, 1)
    stream.show(pictures.free, REST_S - 0.2)
    assert stream.taken() is None
    stream.show(pictures.free, BATCH_S + 0.4)
    assert stream.taken() == UNTOUCHED_FRAMES
    assert stream.frames.spoiled == 1


def test_nobody_knows_what_touched_while_no_frame_came(stream: Stream, pictures: Any) -> None:
    stream.show(pictures.free, REST_S + BATCH_S / 2)
    stream.s += GAP_S + 1
    stream.show(pictures.free, REST_S)
    assert stream.taken() is None
    assert stream.frames.spoiled == 1
    stream.s -= 500  # another clock
    stream.show(pictures.free, REST_S)
    assert stream.taken() is None


def test_a_frame_in_doubt_tells_its_doubt(stream: Stream, pictures: Any) -> None:
    stream.show(pictures.free, REST_S + BATCH_S / 2)
    stream.show(pictures.free, 0.1, DOUBT)
    assert stream.taken() == DOUBT
    assert stream.frames.spoiled == 1
    stream.show(pictures.free, PERIOD_S - 1)
    assert stream.taken() is None
