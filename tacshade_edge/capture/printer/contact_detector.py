"""Detects from the camera whether a step of the head made contact, and stops if the pictures cannot be trusted."""

from __future__ import annotations

import time

import numpy as np

from tacshade_edge.capture.live import Live
from tacshade_edge.capture.printer.keypress_stop import KeypressStop
from tacshade_edge.capture.printer.safety_stop import SafetyStop, Stopped
from tacshade_edge.core.calibration.presses.press_check import Judgement, PressCheck
from tacshade_edge.core.calibration.reference.stillness import REST_MOST_GREY, block_means, motion_grey
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.types import F32, U8, Frame

# The machine swings for `_SETTLE_S` after a move; then `_FRAMES` frames are averaged.
_SETTLE_S, _FRAMES, _FRAMES_MOST_S = 0.15, 4, 5.0
# Contact changes a block's mean by more than `_REST_FACTOR` times the change at rest plus `_CONTACT_GREY` levels. A
# ball pressed 0.02 mm deep changes it by 3.4 to 10 levels, rest by 0.6 to 1.2 (four simulated sensors, 640x480).
_REST_FACTOR, _CONTACT_GREY = 2.0, 2.0
_REST_LOOKS = 6
_FREE_WAIT_S, _STILL_MOST_S = 15.0, 20.0


class ContactDetector:
    """Contact between indenter and skin, detected from the camera's pictures.

    Parameters
    ----------
    live : Live
    check : PressCheck
        Made from the references.
    keypress : KeypressStop
    """

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
        """Wait until the skin has come to rest below the head, and keep its picture as that of the free skin.

        Raises
        ------
        SafetyStop
            The picture still shows contact or motion after `_FREE_WAIT_S`; and as `look`.
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
        """Whether anything touches the skin, compared with the free skin of `learn_free`.

        Raises
        ------
        SafetyStop
            The camera repeats one picture, has moved, delivers too few frames, or delivers unusable ones.
        Stopped
        DeviceError
            The camera is lost.
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
