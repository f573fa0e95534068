"""What a sensor's process tells its hand of each frame."""

from __future__ import annotations

from typing import Final

from tacshade_edge.daemon.hand.lines import FingerLine
from tacshade_edge.daemon.pipeline.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.protocol.hand import away, finger_of
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.settings import Settings
from tacshade_edge.types import Need

PERIOD_NS: Final = 100_000_000  # without contact; in contact every frame tells


class FingerReporter(FrameObserver):
    """One sensor as a finger: tells while somebody listens to the hand, and then asks for depth."""

    def __init__(self, line: FingerLine, hand_T_sensor: Rigid) -> None:
        self._line = line
        self._hand_T_sensor = hand_T_sensor
        self._told: tuple[bool, bool] | None = None
        self._told_ns = 0

    def need(self) -> Need:
        """How much of the next frame the hand asks for."""
        return Need.DEPTH if self._line.wanted else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        """Tell of a frame's result: of each in contact, of each change, and else ten times a second."""
        if (result := seen.reconstruction) is None or not self._line.wanted:
            self._told = None
            return
        now = (result.contact, result.valid)
        if result.contact or now != self._told or not 0 <= result.t_ns - self._told_ns < PERIOD_NS:
            self._told, self._told_ns = now, result.t_ns
            self._line.tell(finger_of(result, self._hand_T_sensor))

    def settings_changed(self, settings: Settings) -> None:
        """Take over where the sensor is in its hand."""
        if settings.hand_T_sensor:
            self._hand_T_sensor = from_seven(settings.hand_T_sensor)

    def source_changed(self, source: SourceState) -> None:
        """Tell that no usable frames come, whoever listens."""
        if source.reason:
            self._line.tell(away(source.reason))
