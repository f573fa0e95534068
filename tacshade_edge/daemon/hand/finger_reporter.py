"""Reports a sensor's frames to its hand, from the sensor's process."""

from __future__ import annotations

from typing import Final

from tacshade_edge.daemon.hand.lines import FingerLine
from tacshade_edge.daemon.pipeline.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.protocol.hand import away, finger_of
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.settings import Settings
from tacshade_edge.types import Need

PERIOD_NS: Final = 100_000_000  # without contact; in contact, every frame is reported


class FingerReporter(FrameObserver):
    """One sensor as a finger: while somebody listens to the hand, it requests depth and reports."""

    def __init__(self, line: FingerLine, hand_T_sensor: Rigid) -> None:
        self._line = line
        self._hand_T_sensor = hand_T_sensor
        self._reported: tuple[bool, bool] | None = None
        self._reported_ns = 0

    def need(self) -> Need:
        """How much of the next frame the hand needs."""
        return Need.DEPTH if self._line.wanted else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        """Report a frame's result: every one in contact, every change, and otherwise ten a second."""
        if (result := seen.reconstruction) is None or not self._line.wanted:
            self._reported = None
            return
        now = (result.contact, result.valid)
        if result.contact or now != self._reported or not 0 <= result.t_ns - self._reported_ns < PERIOD_NS:
            self._reported, self._reported_ns = now, result.t_ns
            self._line.report(finger_of(result, self._hand_T_sensor))

    def settings_changed(self, settings: Settings) -> None:
        """Take the sensor's new pose in its hand."""
        if settings.hand_T_sensor:
            self._hand_T_sensor = from_seven(settings.hand_T_sensor)

    def source_changed(self, source: SourceState) -> None:
        """Report that no usable frames come, even if nobody listens."""
        if source.reason:
            self._line.report(away(source.reason))
