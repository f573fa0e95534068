"""Results from a camera or a recording: a frame is read when a result is requested,
in the caller's thread.
"""

from __future__ import annotations

import logging
import os
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from tacshade_edge.calibration import loading
from tacshade_edge.camera.frame_source import FrameSource
from tacshade_edge.camera.sources import make_source
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.hand import hand_recordings
from tacshade_edge.library.arguments import path_of, wrong
from tacshade_edge.library.result import Result, Results
from tacshade_edge.library.sensor import Sensor, load
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.recording_content import CALIBRATION_NAME
from tacshade_edge.recording.video import DEFAULT_FPS
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.sensor.profiles import AUTO, DEFAULT, PROFILES
from tacshade_edge.settings import Settings, V4l2, check_source
from tacshade_edge.settings import load as load_settings
from tacshade_edge.types import Frame
from tacshade_edge.wire.hand_topics import HandObjects

_log = logging.getLogger(__name__)

_STALE_PERIODS: Final = 2
"""A frame older than this when it is read has waited behind a newer one."""
_WAITING_MAX: Final = 8
"""More than a driver's buffers: if this many frames in a row are late,
the camera itself is late.
"""


def open(source: str | os.PathLike[str], sensor: Sensor | None = None) -> Results:
    """Open a camera and reconstruct its newest frame whenever a result is requested.

    A reader that is slower than the camera gets the newest frame; the others are passed over.

    Parameters
    ----------
    source : path
        A device such as ``/dev/video0``, or a settings file (``.yaml``) that names a camera, a
        folder or the simulated sensor.
    sensor : Sensor, optional
        By default, the calibration and profile that the settings name;
        for a device, the service's calibration.

    Returns
    -------
    Results
        An iterator without an end; the camera is open until it is closed.

    Raises
    ------
    ConfigError
        The arguments or settings can never work.
    DeviceError
        The camera is missing, in use, or delivers no frame. Later, from ``next``: the camera was
        lost; the next call reopens it.
    """
    path = path_of("source", source)
    _check_sensor(sensor)
    if path.suffix.lower() in (".yaml", ".yml"):
        settings, sensor = _of_settings(path, sensor)
    # Not only /dev/video0: the names below /dev/v4l/by-id stay when devices are plugged in anew.
    elif path.is_relative_to("/dev"):
        sensor = sensor or load(Settings().calibration)
        settings = Settings(source=V4l2(device=str(path)))
    else:
        raise ConfigError(
            f"{path}: found another kind of file, expected a settings file (.yaml) or a device "
            "such as /dev/video0"
        )
    rows, cols = sensor.image_size_px
    fps = settings.source.fps or DEFAULT_FPS
    return _Live(make_source(settings.source, (cols, rows)), sensor, fps)


def _of_settings(path: Path, sensor: Sensor | None) -> tuple[Settings, Sensor]:
    """Load a settings file, and the sensor that it names if none is given. Raises ConfigError."""
    document = load_settings(path)
    # Before the calibration is loaded, which takes longer.
    check_source(document)
    settings = document.settings
    # Without a sensor the settings choose the profile, and `auto` is no profile.
    if sensor is None:
        if settings.profile == AUTO:
            where = document.where("profile")
            raise ConfigError(
                f"{where}: found {AUTO}, expected another profile, "
                f"because only the daemon supports {AUTO}; alternatively, pass a sensor"
            )
        sensor = Sensor(loading.load_calibration(document), settings.profile)
    return settings, sensor


def read(recording: str | os.PathLike[str], sensor: Sensor | None = None) -> Results:
    """Read a recording and reconstruct every frame in order.

    The log reports damaged and cut-off frames; `passed_over` counts the damaged ones.

    Parameters
    ----------
    recording : path
        A folder or MCAP file that ``tacshade-edge record`` made, any folder of images, an image, or
        a video (docs/how-to/replay.md).
    sensor : Sensor, optional
        By default, the sensor with the recording's own calibration and the profile ``balanced``.

    Returns
    -------
    Results
        An iterator that ends with the recording; `seq` and times are the recorded ones.

    Raises
    ------
    ConfigError
        There is nothing to read, or no calibration.
    """
    path = path_of("recording", recording)
    _check_sensor(sensor)
    frames = Recording(path)
    for line in (
        frames.damage,
        f"{path}: the recording was cut off; reading what is whole" if frames.cut_off else "",
    ):
        if line:
            _log.warning("%s", line)
    if sensor is None:
        # Its own calibration, not the service's: the sensor may have been calibrated since.
        if (own := loading.of_recording(path)) is None:
            raise ConfigError(
                f"{path}: the recording contains no {CALIBRATION_NAME}; pass a sensor: "
                "read(recording, sensor)"
            )
        sensor = Sensor(own, DEFAULT)
    return _Recorded(frames, sensor)


def _check_sensor(sensor: object) -> None:
    if not (sensor is None or isinstance(sensor, Sensor)):
        raise wrong("sensor", sensor, "what tacshade_edge.load gives")


class _Live(Results):
    def __init__(self, source: FrameSource, sensor: Sensor, fps: float) -> None:
        self._source, self._sensor, self._tracker = source, sensor, ContactTracker()
        # From the settings and not from the camera, which need not deliver what was asked of it.
        self._stale_ns = _STALE_PERIODS * 1e9 / fps
        self._skipped = 0
        self._opened = False
        self._open()

    @property
    def passed_over(self) -> int:
        return self._source.dropped + self._skipped

    def _next(self) -> Result | None:
        try:
            if not self._opened:
                self._open()
            frame = self._newest()
        except DeviceError:
            # So that the next call opens the camera anew.
            self._source.close()
            self._opened = False
            raise
        return None if frame is None else self._sensor.step(frame, self._tracker)

    def _release(self) -> None:
        self._source.close()

    def _open(self) -> None:
        self._source.open()
        self._opened = True

    def _newest(self) -> Frame | None:
        # A driver hands out its oldest buffer first, so read until a frame is fresh.
        waiting = 0
        while True:
            try:
                frame = self._source.read()
            except DecodeError as error:
                _log.debug("%s", error)
                self._skipped += 1
                continue
            waiting += 1
            if (
                frame is None
                or waiting > _WAITING_MAX
                or time.monotonic_ns() - frame.t_ns <= self._stale_ns
            ):
                return frame
            self._skipped += 1


class _Recorded(Results):
    def __init__(self, recording: Recording, sensor: Sensor) -> None:
        self._recording, self._sensor, self._tracker = recording, sensor, ContactTracker()
        self._skipped = 0

    @property
    def passed_over(self) -> int:
        return self._skipped

    def _next(self) -> Result | None:
        while True:
            try:
                recorded = self._recording.read()
            except DecodeError as error:
                _log.warning("%s", error)
                self._skipped += 1
                continue
            return None if recorded is None else self._sensor.step(recorded.frame, self._tracker)

    def _release(self) -> None:
        del self._recording


def read_hand(
    recordings: Iterable[str | os.PathLike[str]], *, profile: str = DEFAULT
) -> Iterator[HandObjects]:
    """Read recordings of a hand's fingers and yield the messages
    that the hand would have published.

    See docs/how-to/hand.md. The log reports damaged and cut-off recordings.

    Parameters
    ----------
    recordings : iterable of path
        Recorded at the same time by the sensors of one hand;
        each holds its calibration and the sensor's pose.
    profile : str
        ``fast``, ``balanced`` or ``accurate``.

    Yields
    ------
    HandObjects
        Lengths in mm, vectors along the hand's axes.

    Raises
    ------
    ConfigError
        A path is not a finger's recording, two recordings are of one sensor,
        or they are of several hands.
    """
    # A path is iterable too: letter by letter.
    if isinstance(recordings, str | os.PathLike) or not isinstance(recordings, Iterable):
        raise wrong("recordings", recordings, "a list of paths")
    paths = [path_of("recordings", path) for path in recordings]
    if not paths:
        raise wrong("recordings", [], "a list of paths")
    if not isinstance(profile, str) or profile not in PROFILES:
        raise wrong("profile", profile, f"one of {', '.join(sorted(PROFILES))}")
    return hand_recordings.read_hand(paths, profile).messages
