"""What a sensor's process tells its hand of each frame."""

from __future__ import annotations

from typing import Final

from tacshade_edge.daemon.hand.lines import FingerLine
from tacshade_edge.daemon.pipeline.ledger import FrameOutcome
from tacshade_edge.daemon.pipeline.workers import Sink
from tacshade_edge.protocol.hand import away, finger_of
from tacshade_edge.reasons import Reason
from tacshade_edge.rigid import Rigid
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction

PERIOD_NS: Final = 100_000_000  # without contact; in contact every frame tells


class TellingFinger:
    """One sensor as a finger: tells while somebody listens to the hand, and then asks for depth.

    Parameters
    ----------
    line : FingerLine
    hand_T_sensor : Rigid

    Attributes
    ----------
    hand_T_sensor : Rigid
        May be replaced at any time.
    """

    def __init__(self, line: FingerLine, hand_T_sensor: Rigid) -> None:
        self._line = line
        self.hand_T_sensor = hand_T_sensor
        self._told: tuple[bool, bool] | None = None
        self._told_ns = 0

    def observing(self, sink: Sink) -> Sink:
        """`sink`, whose results the hand is told too."""
        return _TellingSink(sink, self)

    def need(self) -> Need:
        """How much of the next frame the hand asks for."""
        return Need.DEPTH if self._line.wanted else Need.CONTACT

    def see(self, result: Reconstruction | None) -> None:
        """Tell of a frame's result: of each in contact, of each change, and else ten times a second."""
        if result is None or not self._line.wanted:
            self._told = None
            return
        now = (result.contact, result.valid)
        if result.contact or now != self._told or not 0 <= result.t_ns - self._told_ns < PERIOD_NS:
            self._told, self._told_ns = now, result.t_ns
            self._line.tell(finger_of(result, self.hand_T_sensor))

    def lose(self, reason: Reason) -> None:
        """Tell that no usable frames come; from any thread, whoever listens."""
        self._line.tell(away(reason))


class _TellingSink:
    def __init__(self, sink: Sink, finger: TellingFinger) -> None:
        self._sink = sink
        self._finger = finger

    def need(self) -> Need:
        return self._finger.need() | self._sink.need()

    def deliver(
        self, frame: Frame, result: Reconstruction | None, calibration: Calibration | None
    ) -> FrameOutcome | None:
        outcome = self._sink.deliver(frame, result, calibration)
        self._finger.see(result)
        return outcome
