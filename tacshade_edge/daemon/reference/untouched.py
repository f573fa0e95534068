"""Frames of the resting sensor, taken now and then from the running stream so that the reference can follow."""

from __future__ import annotations

from tacshade_edge.reasons import Reason
from tacshade_edge.types import U8, Frame, Reconstruction

UNTOUCHED_FRAMES = 10
# A dent after a release is gone after 3 s; a soft skin under a long press needs a little more.
REST_S = 10.0
# What the reference follows changes over minutes and years.
PERIOD_S = 60.0
# After a longer gap between frames, nobody knows what touched.
GAP_S = 3.0


class UntouchedFrames:
    """Ten frames of a sensor at rest once per `PERIOD_S`; a touched, invalid or doubtful frame ends them.

    The reconstruct thread passes in every frame, the main thread takes the result. Time is that of the frames.

    Attributes
    ----------
    at_rest : bool
        Whether nothing touched in the latest frame.
    spoiled : int
        How often frames were begun and not finished.
    """

    def __init__(self) -> None:
        self.at_rest = False
        self.spoiled = 0
        self._images: list[U8] = []
        self._finished: list[U8] | Reason | None = None  # set by one thread, cleared by the other
        self._last_ns: int | None = None
        self._touched_ns = self._due_ns = 0

    def take(self) -> list[U8] | Reason | None:
        """The frames, or the doubt about one of them; None if there are none. Until taken, they block further ones."""
        finished = self._finished
        if finished is not None:
            self._finished = None
        return finished

    def see(self, frame: Frame, result: Reconstruction | None) -> None:
        """Take the next frame; one without a result shows a contact."""
        now_ns, last_ns = frame.t_ns, self._last_ns
        self._last_ns = now_ns
        known = last_ns is not None and 0 <= now_ns - last_ns <= GAP_S * 1e9
        self.at_rest = result is not None and result.valid and not result.contact
        if not known or not self.at_rest:
            self._touched_ns = now_ns
            self._spoil()
        elif self._finished is None and now_ns >= max(self._due_ns, self._touched_ns + int(REST_S * 1e9)):
            self._add(frame, result.degraded if result else None)

    def _add(self, frame: Frame, doubt: Reason | None) -> None:
        if doubt is not None:
            self._spoil()
            self._finish(doubt, frame.t_ns)
            return
        self._images.append(frame.image)
        if len(self._images) == UNTOUCHED_FRAMES:
            images, self._images = self._images, []
            self._finish(images, frame.t_ns)

    def _finish(self, outcome: list[U8] | Reason, now_ns: int) -> None:
        self._due_ns = now_ns + int(PERIOD_S * 1e9)
        self._finished = outcome

    def _spoil(self) -> None:
        if self._images:
            self._images = []
            self.spoiled += 1
