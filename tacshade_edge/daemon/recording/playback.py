"""Plays a recording for a person: paused, frame by frame, from anywhere, faster and slower (``req/replay``)."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Final

from tacshade_edge.protocol.requests import PlaybackCommand
from tacshade_edge.storage.recording.recording import RecordedFrame, Recording

Changed = Callable[[dict[str, Any]], None]
_MS: Final = 3  # decimals of a second
REPORT_PERIOD_S: Final = 1.0
"""How often the status is repeated while paused: a slow page loses what comes faster than it can take."""


class Playback:
    """Provides each frame when it is due; the end is a pause, after which playback can continue anywhere.

    One thread calls `read`; any thread may call `command` and `status`.

    Parameters
    ----------
    reopen : callable
        Opens the recording at its first frame.
    speed : float
        Factor on the recording's pace.
    changed : callable
        ``changed(status)`` after every command, and at the end.
    """

    def __init__(self, reopen: Callable[[], Recording], speed: float, changed: Changed) -> None:
        self._reopen = reopen
        self._recording = reopen()
        self._changed = changed
        self._wake = threading.Condition()
        self._speed = speed
        self._paused = False
        self._steps = self._backs = 0
        self._seek_ns: int | None = None  # after the first frame
        self._start: tuple[int, int] | None = None  # our time and the recording's when the present pace began
        self._first_ns: int | None = None
        self._last_ns = 0  # time of the latest frame that was shown
        self._seq: int | None = None

    def command(self, command: PlaybackCommand) -> dict[str, Any]:
        """Carry out a command and return the resulting status."""
        with self._wake:
            self._start = None
            if command.paused is not None:
                self._paused = command.paused
            if command.step:
                self._paused = True
                self._steps += 1
            if command.back:
                self._paused = True
                self._backs += 1
            if command.speed is not None:
                self._speed = command.speed
            if command.seek_s is not None:
                self._seek_ns = round(command.seek_s * 1e9)
            self._wake.notify_all()
        status = self.status()
        self._changed(status)
        return status

    def status(self) -> dict[str, Any]:
        """The content of ``status/replay``, without its state and reason."""
        with self._wake:
            return {
                "paused": self._paused,
                "speed": self._speed,
                "position_s": round((self._last_ns - (self._first_ns or 0)) / 1e9, _MS),
                "length_s": round(self._recording.length_ns / 1e9, _MS),
                "frame": self._seq,
            }

    def read(self) -> RecordedFrame:
        """Wait for the next frame to show.

        Raises
        ------
        DecodeError
            The image cannot be used; the next call continues with the next frame.
        ConfigError
            As for `Recording`.
        """
        ahead: RecordedFrame | None = None
        still_paused = False
        while True:
            if still_paused:
                self._changed(self.status())
            with self._wake:
                target_ns, self._seek_ns = self._seek_ns, None
                backs, self._backs = self._backs, 0
            wound = target_ns is not None or backs > 0
            if target_ns is not None:
                ahead = self._from(target_ns, ahead)
            elif backs:
                ahead = self._before(backs)
            ahead = ahead or self._recording.read()
            if ahead is None:
                self._end()
                continue
            t_ns = ahead.frame.t_ns
            with self._wake:
                if self._first_ns is None:
                    self._first_ns = t_ns
                if self._wound:
                    continue
                wait_s = 0.0 if wound else self._wait_s(t_ns)
                if wait_s > 0:
                    still_paused = not self._wake.wait(min(wait_s, REPORT_PERIOD_S)) and self._paused
                    continue
                self._steps = max(self._steps - 1, 0)
                self._last_ns, self._seq = t_ns, ahead.frame.seq
            return ahead

    @property
    def _wound(self) -> bool:
        """Whether a frame other than the next is requested."""
        return self._seek_ns is not None or self._backs > 0

    def _wait_s(self, t_ns: int) -> float:
        if self._paused:
            return 0.0 if self._steps else float("inf")
        now_ns = time.monotonic_ns()
        self._start = self._start or (now_ns, t_ns)
        return (self._start[0] + (t_ns - self._start[1]) / self._speed - now_ns) / 1e9

    def _from(self, target_ns: int, ahead: RecordedFrame | None) -> RecordedFrame | None:
        """The first frame at least `target_ns` after the recording's first one."""
        target_ns += self._first_ns or 0
        if target_ns <= max(self._last_ns, ahead.frame.t_ns if ahead else 0):
            self._recording = self._reopen()
        self._recording.skip_to(target_ns)
        with self._wake:
            self._start = None
        return self._recording.read()

    def _before(self, frames: int) -> RecordedFrame | None:
        """The frame that is this many before the latest one shown, or the first."""
        self._recording = self._reopen()
        self._recording.skip_to_before(self._last_ns, frames)
        return self._recording.read()

    def _end(self) -> None:
        with self._wake:
            self._paused, self._steps = True, 0
        again = False
        while not again:
            self._changed(self.status())
            with self._wake:
                again = bool(
                    self._wake.wait_for(lambda: not self._paused or self._steps or self._wound, REPORT_PERIOD_S)
                )
        with self._wake:
            if not self._wound:
                self._seek_ns = 0  # play again from the first frame
