"""Reconstructs recordings of one hand's fingers to the messages
that the hand would have published.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.calibration import loading
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.hand.fingers import messages
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.recording_content import CALIBRATION_NAME, SETTINGS_NAME, content_of
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor, step_and_track
from tacshade_edge.settings import Settings, strict_yaml
from tacshade_edge.settings.conversion import convert
from tacshade_edge.settings.model import wrong_with
from tacshade_edge.wire.hand_messages import finger_of
from tacshade_edge.wire.hand_topics import Finger, HandObjects

_log = logging.getLogger(__name__)


def recorded_settings(content: dict[str, bytes]) -> Settings | None:
    """The settings of the sensor that a recording was made with; None if it has none.

    Raises ConfigError.
    """
    if SETTINGS_NAME not in content:
        return None
    # Not `load`, which refuses a hand's finger without its hand.
    return convert(strict_yaml.parse(Path(SETTINGS_NAME), content[SETTINGS_NAME]), Settings)


@dataclass(frozen=True, slots=True, eq=False)
class HandRecording:
    """Several recordings of a hand; `unread` gets a line for each image that cannot be read,
    as the log does.
    """

    hand_id: str
    fingers: tuple[str, ...]
    messages: Iterator[HandObjects]
    unread: list[str]


@dataclass(frozen=True, slots=True, eq=False)
class _Recorded:
    recording: Recording
    reconstructor: Reconstructor
    hand_T_sensor: Rigid
    unread: list[str]

    def reports(self) -> Iterator[tuple[int, int, Finger]]:
        tracker = ContactTracker()
        while True:
            try:
                recorded = self.recording.read()
            except DecodeError as error:
                _log.warning("%s", error)
                self.unread.append(str(error))
                continue
            if recorded is None:
                return
            result = step_and_track(self.reconstructor, tracker, recorded.frame)
            assert result is not None  # by default everything is needed
            yield result.t_ns, recorded.wall_ns, finger_of(result, self.hand_T_sensor)


def read_hand(paths: Sequence[Path], profile: str) -> HandRecording:
    """Read recordings of several fingers of one hand, made at the same time.

    Raises ConfigError if a recording lacks its calibration or a finger's settings.
    """
    fingers: dict[str, _Recorded] = {}
    hands, unread = set[str](), list[str]()
    for path in paths:
        settings = recorded_settings(content_of(path))
        if settings is None or settings.hand_id is None or settings.hand_T_sensor is None:
            raise ConfigError(
                f"{path}: found a recording without hand_T_sensor in its {SETTINGS_NAME}, "
                "expected a recording of a hand's finger"
            )
        if problem := wrong_with(settings.hand_T_sensor):
            raise ConfigError(f"{path}: {SETTINGS_NAME}: hand_T_sensor: {problem}")
        hands.add(settings.hand_id)
        if len(hands) > 1:
            named = ", ".join(sorted(hands))
            raise ConfigError(
                f"{path}: found recordings of the hands {named}, expected recordings of one hand"
            )
        if settings.sensor_id in fingers:
            text = (
                f"{path}: found a second recording of {settings.sensor_id}, "
                "expected one recording per finger"
            )
            raise ConfigError(text)
        if (calibration := loading.of_recording(path)) is None:
            raise ConfigError(
                f"{path}: found no {CALIBRATION_NAME}, expected one in each recording"
            )
        recording = Recording(path)
        cut_off = "the recording was cut off; reading what is whole" if recording.cut_off else ""
        for line in filter(None, (recording.damage, cut_off)):
            _log.warning("%s: %s", path, line)
        fingers[settings.sensor_id] = _Recorded(
            recording,
            make_reconstructor(calibration, PROFILES[profile]),
            from_seven(settings.hand_T_sensor),
            unread,
        )
    (hand_id,) = hands
    made = messages({name: finger.reports() for name, finger in fingers.items()})
    return HandRecording(hand_id, tuple(fingers), made, unread)
