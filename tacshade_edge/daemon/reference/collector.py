"""Collects frames for a new reference from the running stream."""

from __future__ import annotations

from collections.abc import Callable

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import U8, Frame, Reconstruction

REFERENCE_FRAMES = 10


class ReferenceCollector:
    """Collects the images of the next frames; one touched or invalid frame spoils them.

    Parameters
    ----------
    done : callable
        ``done(outcome)``, called once: all images, or the reason that they cannot be used.
    """

    def __init__(self, done: Callable[[list[U8] | Reason], None]) -> None:
        self._done = done
        self._images: list[U8] = []
        self._finished = False

    def see(self, frame: Frame, result: Reconstruction) -> None:
        """Take the next frame."""
        if self._finished:
            return
        if not result.valid:
            found = f"frame {frame.seq}: found an invalid frame ({result.reason})"
            expected = "expected a valid frame of an untouched sensor"
            self._finish(Reason(ReasonCode.FRAME_INVALID, f"{found}, {expected}"))
        elif result.contact:
            found = f"frame {frame.seq}: found a contact {result.depth_max_mm:.2f} mm deep"
            self._finish(Reason(ReasonCode.FRAME_IN_CONTACT, f"{found}, expected no contact"))
        else:
            self._images.append(frame.image)
            if len(self._images) == REFERENCE_FRAMES:
                self._finish(self._images)

    def _finish(self, outcome: list[U8] | Reason) -> None:
        self._finished = True
        self._done(outcome)
