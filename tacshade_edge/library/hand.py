"""Compute what a whole hand touches and holds from recordings of its fingers."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator

from tacshade_edge.core.profiles import DEFAULT, PROFILES
from tacshade_edge.factories import hand_recordings
from tacshade_edge.library.arguments import path_of, wrong
from tacshade_edge.protocol.topics import HandObjects


def read_hand(recordings: Iterable[str | os.PathLike[str]], *, profile: str = DEFAULT) -> Iterator[HandObjects]:
    """Read recordings of a hand's fingers and yield the messages that the hand would have published.

    See docs/how-to/hand.md. The log reports damaged and cut-off recordings.

    Parameters
    ----------
    recordings : iterable of path
        Recorded at the same time by the sensors of one hand; each holds its calibration and the sensor's pose.
    profile : str
        ``fast``, ``balanced`` or ``accurate``.

    Yields
    ------
    HandObjects
        Lengths in mm, vectors along the hand's axes.

    Raises
    ------
    ConfigError
        A path is not a finger's recording, two recordings are of one sensor, or they are of several hands.
    """
    if isinstance(recordings, str | os.PathLike) or not isinstance(recordings, Iterable):
        raise wrong("recordings", recordings, "a list of paths")
    paths = [path_of("recordings", path) for path in recordings]
    if not paths:
        raise wrong("recordings", [], "a list of paths")
    if not isinstance(profile, str) or profile not in PROFILES:
        raise wrong("profile", profile, f"one of {', '.join(sorted(PROFILES))}")
    return hand_recordings.read_hand(paths, profile).messages
