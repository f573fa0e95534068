"""What of a reconstruction is published, and when."""

from __future__ import annotations

from collections.abc import Callable

from tacshade_edge.daemon.ledger import Outcome
from tacshade_edge.protocol import messages, wire
from tacshade_edge.types import Calibration, Frame, Reconstruction

CONTACT_PERIOD_NS = 100_000_000  # without contact; in contact every frame tells


class Publisher:
    """The `Sink` of the daemon.

    With contact: ``height``, ``cloud`` and ``contact`` of every frame. Without: one zero ``height`` when the
    contact ends (flagged when an invalid frame ended it), then only ``contact`` at 10 Hz. A frame whose
    height is offered is settled by what becomes of that offer.

    Parameters
    ----------
    offer : callable
        ``offer(stream, payload, seq)``; must not wait.
    """

    def __init__(self, offer: Callable[[str, bytes, int], None]) -> None:
        self._offer = offer
        self._touching = False
        self._told_contact_ns: int | None = None
        self.fps = 0.0
        self.latest: tuple[Frame, Reconstruction] | None = None

    def deliver(self, frame: Frame, result: Reconstruction, calibration: Calibration) -> Outcome | None:
        """Offer what this result has to say."""
        self.latest = frame, result
        changed = result.contact != self._touching
        self._touching = result.contact
        crc32, pose, error_us = calibration.crc32, frame.pose, frame.pose_error_us
        if result.contact or changed:
            height = wire.encode_height(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("height", height, result.seq)
        if result.contact:
            cloud = wire.encode_cloud(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("cloud", cloud, result.seq)
        told_ns = self._told_contact_ns
        if result.contact or changed or told_ns is None or result.t_ns - told_ns >= CONTACT_PERIOD_NS:
            self._told_contact_ns = result.t_ns
            self._offer("contact", messages.encode_contact(result, fps=self.fps), result.seq)
        if result.contact or changed:
            return None
        return "without_contact" if result.valid else "invalid"
