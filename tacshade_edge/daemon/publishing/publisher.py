"""Decides what is published of a reconstruction, and when."""

from __future__ import annotations

from collections.abc import Callable

from tacshade_edge.daemon.pipeline.ledger import FrameOutcome
from tacshade_edge.daemon.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.protocol import messages, wire
from tacshade_edge.settings import Settings
from tacshade_edge.types import Need, Reconstruction, Slip

CONTACT_PERIOD_NS = 100_000_000  # without contact; in contact, every frame is published


class Publisher(FrameObserver):
    """Publishes what subscribers want of a frame, and settles the frame.

    With contact: ``height``, ``cloud``, ``shear``, ``sigma``, ``touch`` and ``contact`` of every frame, and one
    ``event/slip`` when an object begins to slide. Without: one zero ``height`` and one empty ``touch`` when the contact
    ends (flagged if an invalid frame ended it), then only ``contact`` at 10 Hz. If a frame's height is offered, the
    outcome of that offer settles the frame.
    Messages without a listener are left out, except at the beginning and end of a contact that is or was published: no
    subscriber is left with outdated values.

    Parameters
    ----------
    offer : callable
        ``offer(stream, payload, seq)``; must not wait.
    publish_event : callable
        ``publish_event(topic, payload)`` publishes an event; must not wait.
    settle : callable
        ``settle(seq, outcome)`` for a frame whose height is not offered.
    has_listener : callable
        ``has_listener(stream)``; by default every stream has one.
    always_shear : bool
        Request shear even without a listener: for slip, and for its numbers in ``contact``.

    Attributes
    ----------
    fps : float
        Frame rate that ``contact`` reports.
    """

    def __init__(
        self,
        offer: Callable[[str, bytes, int], None],
        publish_event: Callable[[str, bytes], None],
        settle: Callable[[int, FrameOutcome], None],
        has_listener: Callable[[str], bool] = lambda stream: True,
        always_shear: bool = False,
    ) -> None:
        self._offer = offer
        self._publish_event = publish_event
        self._settle = settle
        self._has_listener = has_listener
        self._always_shear = always_shear
        self._sliding: frozenset[int | None] = frozenset()
        self._contact = False
        self._contact_sent_ns: int | None = None
        self.fps = 0.0

    def need(self) -> Need:
        """How much of a frame the listeners need."""
        need = Need.SHEAR if self._always_shear or self._has_listener("shear") else Need.CONTACT
        if self._has_listener("sigma"):
            need |= Need.SIGMA
        if self._has_listener("touch"):
            need |= Need.TOUCH
        if any(map(self._has_listener, ("height", "cloud", "contact"))):
            need |= Need.DEPTH
        return need

    def settings_changed(self, settings: Settings) -> None:
        """Request shear as the settings say."""
        self._always_shear = settings.shear == "always"

    def see(self, seen: FrameResult) -> None:
        """Offer the messages of this result."""
        if (result := seen.reconstruction) is None:
            self._settle(seen.frame.seq, "unasked")
            return
        changed = result.contact != self._contact
        self._contact = result.contact
        height_goes = changed or (result.contact and self._has_listener("height"))
        if height_goes:
            self._send("height", wire.encode_height, result, seen)
        if result.contact and (changed or self._has_listener("cloud")):
            self._send("cloud", wire.encode_cloud, result, seen)
        if result.shear_mm is not None and (result.contact or changed) and self._has_listener("shear"):
            self._send("shear", wire.encode_shear, result, seen)
        if result.sigma_mm is not None and (result.contact or changed) and self._has_listener("sigma"):
            self._send("sigma", wire.encode_sigma, result, seen)
        if (result.touch is not None or (changed and not result.contact)) and self._has_listener("touch"):
            self._offer("touch", messages.encode_touch(result), result.seq)
        sliding = {o.id: o for o in result.objects if o.slip is Slip.FULL}
        for began in sliding.keys() - self._sliding:
            self._publish_event("event/slip", messages.encode_slip(result, sliding[began]))
        self._sliding = frozenset(sliding)
        sent_ns = self._contact_sent_ns
        due = result.contact or sent_ns is None or result.t_ns - sent_ns >= CONTACT_PERIOD_NS
        if changed or (due and self._has_listener("contact")):
            self._contact_sent_ns = result.t_ns
            self._offer("contact", messages.encode_contact(result, fps=self.fps), result.seq)
        if height_goes:
            return
        if result.contact:
            self._settle(result.seq, "unasked")
        else:
            self._settle(result.seq, "without_contact" if result.valid else "invalid")

    def _send(self, stream: str, encode: Callable[..., bytes], result: Reconstruction, seen: FrameResult) -> None:
        frame, calibration = seen.frame, seen.calibration
        payload = encode(
            result,
            calibration_crc32=0 if calibration is None else calibration.crc32,
            pose=frame.pose,
            pose_error_us=frame.pose_error_us,
        )
        self._offer(stream, payload, result.seq)
