"""What of a reconstruction is published, and when."""

from __future__ import annotations

from collections.abc import Callable

from tacshade_edge.daemon.pipeline.ledger import FrameOutcome
from tacshade_edge.protocol import messages, wire
from tacshade_edge.types import Calibration, Frame, Reconstruction

CONTACT_PERIOD_NS = 100_000_000  # without contact; in contact every frame tells


class Publisher:
    """The `Sink` of the daemon.

    With contact: ``height``, ``cloud`` and ``contact`` of every frame. Without: one zero ``height`` when the
    contact ends (flagged when an invalid frame ended it), then only ``contact`` at 10 Hz. A frame whose
    height is offered is settled by what becomes of that offer. What nobody listens to is left out, but never the
    begin or end of a contact that is or was published: nobody is left with an older truth.

    Parameters
    ----------
    offer : callable
        ``offer(stream, payload, seq)``; must not wait.
    has_listener : callable
        ``has_listener(stream)``; by default every stream has one.

    Attributes
    ----------
    fps : float
        For ``contact``.
    latest : (Frame, Reconstruction) or None
        The newest of each; they belong together unless the frame's depth was not needed.
    """

    def __init__(
        self, offer: Callable[[str, bytes, int], None], has_listener: Callable[[str], bool] = lambda stream: True
    ) -> None:
        self._offer = offer
        self._has_listener = has_listener
        self._contact = False
        self._contact_sent_ns: int | None = None
        self.fps = 0.0
        self.latest: tuple[Frame, Reconstruction] | None = None

    def needs_depth(self) -> bool:
        """Whether anyone listens to what is made from depth."""
        return any(map(self._has_listener, ("height", "cloud", "contact")))

    def deliver(self, frame: Frame, result: Reconstruction | None, calibration: Calibration) -> FrameOutcome | None:
        """Offer what is in this result; None is a contact without its depth."""
        if result is None:
            self.latest = self.latest and (frame, self.latest[1])
            return "unasked"
        self.latest = frame, result
        changed = result.contact != self._contact
        self._contact = result.contact
        crc32, pose, error_us = calibration.crc32, frame.pose, frame.pose_error_us
        height_goes = changed or (result.contact and self._has_listener("height"))
        if height_goes:
            height = wire.encode_height(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("height", height, result.seq)
        if result.contact and (changed or self._has_listener("cloud")):
            cloud = wire.encode_cloud(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("cloud", cloud, result.seq)
        sent_ns = self._contact_sent_ns
        due = result.contact or sent_ns is None or result.t_ns - sent_ns >= CONTACT_PERIOD_NS
        if changed or (due and self._has_listener("contact")):
            self._contact_sent_ns = result.t_ns
            self._offer("contact", messages.encode_contact(result, fps=self.fps), result.seq)
        if height_goes:
            return None
        if result.contact:
            return "unasked"
        return "without_contact" if result.valid else "invalid"
