"""Lowers the head step by step while the camera watches, and finds the height of the first touch."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np

from tacshade_edge.capture.live import Live
from tacshade_edge.capture.printer.head import Head, KeypressStop
from tacshade_edge.capture.printer.line import SafetyStop, Stopped
from tacshade_edge.core.calibration.presses.press_check import Judgement, PressCheck
from tacshade_edge.core.calibration.reference.references import REST_MOST_GREY, block_means, motion_grey
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.types import F32, U8, Frame

CLEAR_MM = 5.0
"""Height above the highest touch at which the head moves sideways."""

NEAR_MM = 1.0
"""Height above the touch down to which the head takes long steps; the dry run ends there."""

_LONG_MM, _SHORT_MM = 2.0, 0.5
# How much earlier or later the camera may see a touch than the sensor's location predicts.
_EARLY_MM, _LATE_MM = 0.35, 0.6


class Expected(Enum):
    """What the camera must see after a step."""

    FREE = "no contact"
    ANYTHING = "anything"
    TOUCHED = "contact"


@dataclass(frozen=True, slots=True)
class Step:
    """One move straight down, and what the camera must see after it."""

    z_mm: float
    expected: Expected


def descent(from_z_mm: float, touch_z_mm: float, to_z_mm: float) -> Iterator[Step]:
    """Yield steps straight down, the last one exactly to `to_z_mm`; none if that is not below `from_z_mm`. `from_z_mm`:
    where the head is. `touch_z_mm`: where the indenter is expected to touch.
    """
    z = from_z_mm
    while z > to_z_mm:
        near = touch_z_mm + NEAR_MM
        z = max(z - _LONG_MM, near, to_z_mm) if z > near else max(z - _SHORT_MM, to_z_mm)
        yield Step(z, _expected(z, touch_z_mm))


def search(from_z_mm: float, least_z_mm: float, step_mm: float) -> Iterator[float]:
    """Yield the heights at which to look for a touch on the way down, none below `least_z_mm`."""
    for k in range(1, max(math.floor((from_z_mm - least_z_mm) / step_mm), 0) + 1):
        yield from_z_mm - k * step_mm


def _expected(z_mm: float, touch_z_mm: float) -> Expected:
    if z_mm >= touch_z_mm + _EARLY_MM:
        return Expected.FREE
    return Expected.TOUCHED if z_mm <= touch_z_mm - _LATE_MM else Expected.ANYTHING


# The machine swings for `_SETTLE_S` after a move; then `_FRAMES` frames are averaged.
_SETTLE_S, _FRAMES, _FRAMES_MOST_S = 0.15, 4, 5.0
# Contact changes a block's mean by more than `_REST_FACTOR` times the change at rest plus `_CONTACT_GREY` levels. A
# ball pressed 0.02 mm deep changes it by 3.4 to 10 levels, rest by 0.6 to 1.2 (four simulated sensors, 640x480).
_REST_FACTOR, _CONTACT_GREY = 2.0, 2.0
_REST_LOOKS = 6
_FREE_WAIT_S, _STILL_MOST_S = 15.0, 20.0


class ContactDetector:
    """Contact between indenter and skin, detected from the camera's pictures. `check`: made from the references."""

    def __init__(self, live: Live, check: PressCheck, keypress: KeypressStop) -> None:
        self._live = live
        self._check = check
        self._keypress = keypress
        self._free: F32 | None = None
        self._contact_grey = 0.0

    def learn_rest(self) -> None:
        """Measure how much the picture of the free skin changes while nothing moves. Raises as `look`."""
        looks = [self._look()[0] for _ in range(_REST_LOOKS)]
        rest_grey = max(motion_grey([a, looks[0]]) for a in looks)
        if rest_grey > REST_MOST_GREY:
            raise SafetyStop(
                f"picture at rest: found a change of {rest_grey:.1f} grey levels, expected at most {REST_MOST_GREY:g}"
            )
        self._contact_grey = _REST_FACTOR * rest_grey + _CONTACT_GREY

    def learn_free(self) -> None:
        """Wait until the skin has come to rest below the head, and keep its picture as that of the free skin. Raises
        SafetyStop (the picture still shows contact or motion after `_FREE_WAIT_S`; and as `look`).
        """
        end_s = time.monotonic() + _FREE_WAIT_S
        before, _ = self._look()
        while True:
            now, judged = self._look()
            if not judged.in_contact and motion_grey([before, now]) <= self._contact_grey / 2:
                self._free = now
                return
            if time.monotonic() > end_s:
                raise SafetyStop(
                    "the picture shows contact or does not settle, although the indenter is above the skin"
                )
            before = now

    def look(self) -> bool:
        """Whether anything touches the skin, compared with the free skin of `learn_free`. Raises SafetyStop (the camera
        repeats one picture, has moved, delivers too few frames, or delivers unusable ones), Stopped, DeviceError (the
        camera is lost).
        """
        assert self._free is not None  # a search begins with a free skin
        now, judged = self._look()
        return judged.in_contact or motion_grey([self._free, now]) > self._contact_grey

    def still_image(self) -> U8:
        """Return the picture of the pressed skin once it is still. Raises Stopped, and DeviceError if it never is."""
        frame = self._live.still_frame(_STILL_MOST_S)
        if frame is None:
            self._keypress.check()
            raise Stopped("a key was pressed")
        return np.array(frame.image)

    def _look(self) -> tuple[F32, Judgement]:
        """Return the block means, averaged over frames taken from now on, and the judgement of the last frame."""
        frames = self._frames()
        blocks = [block_means(to_grey(frame.image)) for frame in frames]
        if all(np.array_equal(frames[0].image, frame.image) for frame in frames[1:]):
            raise SafetyStop("the camera keeps delivering the same picture")
        judged = self._check.judge(np.array(frames[-1].image))
        if judged.unusable:
            raise SafetyStop(f"the picture is unusable: {judged.unusable}")
        if judged.moved:
            raise SafetyStop(f"{judged.moved} since the references were taken")
        return np.mean(blocks, axis=0, dtype=np.float32), judged

    def _frames(self) -> list[Frame]:
        from_ns = time.monotonic_ns() + round(1e9 * _SETTLE_S)
        frames: list[Frame] = []
        while len(frames) < _FRAMES:
            self._keypress.check()
            if time.monotonic_ns() - from_ns > 1e9 * _FRAMES_MOST_S:
                raise SafetyStop(f"the camera delivered fewer than {_FRAMES} new pictures within {_FRAMES_MOST_S:g} s")
            frame = self._live.frame()
            if frame.t_ns >= from_ns:
                frames.append(frame)
        return frames


# Step sizes of the successive searches for a touch of unknown height, and of roughly known height.
FROM_AFAR_MM, FROM_NEAR_MM = (1.0, 0.25, 0.05), (0.25, 0.05)

# How far above a touch and its step the head is free again, and how far below the touch it is sought again.
_OFF_MM, _AGAIN_MM = 0.15, 0.1
# How much too low a touch is found on average: half of the last step, plus the depth that the camera needs.
_SEEN_LATE_MM = 0.045
# How far below the expected touch the search goes.
_LOWER_MM = 3.0


class Touch:
    """Moves of one head watched by one camera. All raise Stopped, SafetyStop and DeviceError. `least_z_mm`: the
    printer's lowest allowed z.
    """

    def __init__(self, head: Head, detector: ContactDetector, least_z_mm: float) -> None:
        self.head = head
        self.detector = detector
        self._least_z_mm = least_z_mm

    def down(self, touch_z_mm: float, to_z_mm: float) -> None:
        """Move straight down and check after each step that the camera sees contact only where it must."""
        for step in descent(self.head.z_mm, touch_z_mm, to_z_mm):
            self.head.to(step.z_mm)
            touched = self.detector.look()
            if step.expected is (Expected.FREE if touched else Expected.TOUCHED):
                where = f"{step.z_mm - touch_z_mm:+.2f} mm from the expected first touch"
                found = "contact" if touched else "no contact"
                raise SafetyStop(f"found {found} in the picture {where}, expected {step.expected.value}")

    def lift(self) -> None:
        """Move up to the free height."""
        self.head.to(self.head.free_z_mm)

    def free_over(self, touch_z_mm: float) -> None:
        """Set the free height to `CLEAR_MM` above a touch and move there."""
        self.head.free_z_mm = touch_z_mm + CLEAR_MM
        self.lift()

    def from_near(self, x_mm: float, y_mm: float, expected_z_mm: float) -> float:
        """Touch at a place of roughly known height and return its exact z in mm. The head stays there."""
        self.head.over(x_mm, y_mm)
        self.detector.learn_free()
        self.down(expected_z_mm, expected_z_mm + NEAR_MM)
        return self._touch(expected_z_mm - _LOWER_MM, FROM_NEAR_MM)

    def from_afar(self) -> float:
        """Touch where the height is unknown and return its z in mm. The head stays there."""
        self.detector.learn_free()
        return self._touch(self._least_z_mm, FROM_AFAR_MM)

    def _touch(self, least_z_mm: float, steps_mm: Sequence[float]) -> float:
        """Search for a touch in ever smaller steps, each of which must find again the touch of the step before."""
        for step_mm in steps_mm:
            self._search(max(least_z_mm, self._least_z_mm), step_mm)
            if step_mm == steps_mm[-1]:
                break
            least_z_mm = self.head.z_mm - _AGAIN_MM
            self.head.to(self.head.z_mm + step_mm + _OFF_MM)
            if self.detector.look():
                raise SafetyStop("the picture still shows contact after the head rose")
        return self.head.z_mm + _SEEN_LATE_MM

    def _search(self, least_z_mm: float, step_mm: float) -> None:
        for z_mm in search(self.head.z_mm, least_z_mm, step_mm):
            self.head.to(z_mm)
            if self.detector.look():
                return
        raise SafetyStop(
            f"found no contact down to z {self.head.z_mm:.2f} mm, expected contact above z {least_z_mm:.2f} mm"
        )
