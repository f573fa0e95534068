"""What of a reconstruction is published, and when."""

from __future__ import annotations

from collections.abc import Callable

from tacshade_edge.daemon.pipeline.ledger import FrameOutcome
from tacshade_edge.protocol import messages, wire
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction, Slip

CONTACT_PERIOD_NS = 100_000_000  # without contact; in contact every frame tells


class Publisher:
    """The `Sink` of the daemon.

    With contact: ``height``, ``cloud``, ``shear``, ``sigma`` and ``contact`` of every frame, and one ``event/slip``
    when an object begins to slide. Without: one zero ``height`` when the contact ends (flagged when an invalid frame
    ended it), then only ``contact`` at 10 Hz. A frame whose height is offered is settled by what becomes of that offer.
    What nobody listens to is left out, but never the begin or end of a contact that is or was published: nobody is left
    with an older truth.

    Parameters
    ----------
    offer : callable
        ``offer(stream, payload, seq)``; must not wait.
    tell : callable
        ``tell(topic, payload)`` of an event; must not wait.
    has_listener : callable
        ``has_listener(stream)``; by default every stream has one.
    always_shear : bool
        Displacement is asked for whoever listens: for slip, and for its numbers in ``contact``.

    Attributes
    ----------
    fps : float
        For ``contact``.
    latest : (Frame, Reconstruction) or None
        The newest of each; they belong together unless the frame's depth was not needed.
    """

    def __init__(
        self,
        offer: Callable[[str, bytes, int], None],
        tell: Callable[[str, bytes], None],
        has_listener: Callable[[str], bool] = lambda stream: True,
        always_shear: bool = False,
    ) -> None:
        self._offer = offer
        self._tell = tell
        self._has_listener = has_listener
        self.always_shear = always_shear
        self._sliding: frozenset[int | None] = frozenset()
        self._contact = False
        self._contact_sent_ns: int | None = None
        self.fps = 0.0
        self.latest: tuple[Frame, Reconstruction] | None = None

    def need(self) -> Need:
        """How much of a frame those who listen ask for."""
        need = Need.SHEAR if self.always_shear or self._has_listener("shear") else Need.CONTACT
        if self._has_listener("sigma"):
            need |= Need.SIGMA
        if any(map(self._has_listener, ("height", "cloud", "contact"))):
            need |= Need.DEPTH
        return need

    def deliver(
        self, frame: Frame, result: Reconstruction | None, calibration: Calibration | None
    ) -> FrameOutcome | None:
        """Offer what is in this result; None is a contact without its depth."""
        if result is None:
            self.latest = self.latest and (frame, self.latest[1])
            return "unasked"
        self.latest = frame, result
        changed = result.contact != self._contact
        self._contact = result.contact
        crc32 = 0 if calibration is None else calibration.crc32
        pose, error_us = frame.pose, frame.pose_error_us
        height_goes = changed or (result.contact and self._has_listener("height"))
        if height_goes:
            height = wire.encode_height(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("height", height, result.seq)
        if result.contact and (changed or self._has_listener("cloud")):
            cloud = wire.encode_cloud(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("cloud", cloud, result.seq)
        if result.shear_mm is not None and (result.contact or changed) and self._has_listener("shear"):
            shear = wire.encode_shear(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("shear", shear, result.seq)
        if result.sigma_mm is not None and (result.contact or changed) and self._has_listener("sigma"):
            sigma = wire.encode_sigma(result, calibration_crc32=crc32, pose=pose, pose_error_us=error_us)
            self._offer("sigma", sigma, result.seq)
        sliding = {o.id: o for o in result.objects if o.slip is Slip.FULL}
        for began in sliding.keys() - self._sliding:
            self._tell("event/slip", messages.encode_slip(result, sliding[began]))
        self._sliding = frozenset(sliding)
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
