"""The interface that every frame source implements, and what all cameras share."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from typing import Protocol

from tacshade_edge.errors import DeviceError
from tacshade_edge.types import Frame


class FrameSource(Protocol):
    """A source of frames. It blocks in `read`; the daemon's grab thread keeps the newest frame.

    Life cycle: ``open`` → ``read`` or ``skip`` … → ``close``. After any of them raises
    `DeviceError`, the caller calls ``close`` and may ``open`` again (a source keeps counting
    `Frame.seq` when it is reopened).
    """

    @property
    def dropped(self) -> int:
        """Number of frames known or inferred to be lost before this process saw them,
        since the first open.
        """

    def open(self) -> None:
        """Prepare to read.

        Raises DeviceError (absent, busy, not a camera) or ConfigError (can never work).
        """

    def read(self) -> Frame | None:
        """Return the next frame; None when a finite source has ended.

        Raises DeviceError when the device is lost.
        """

    def skip(self) -> bool:
        """Discard the next frame; return False when a finite source has ended.

        Waits and raises as `read` does.
        """

    def close(self) -> None:
        """Release everything; safe to call twice."""

    def describe(self) -> dict[str, str | int | float]:
        """Return the negotiated settings (format, size, rate, time stamp source),
        for ``status/camera``.
        """


def unix_ns(t_ns: int) -> int:
    """The Unix time of a frame captured at `t_ns` on the monotonic clock; 0 before 1970."""
    # A clock that has just been set to 0 was not there yet when the frame was captured, and the
    # messages' times have no sign.
    return max(0, time.time_ns() - (time.monotonic_ns() - t_ns))


# Long enough that a lost frame hardly moves the period, short enough that a camera which changes
# its rate is believed after about two seconds at 30 fps.
_WINDOW = 64
_ROUNDS = 2
# Relative: an interval this near the period is one period, however the estimate changes, so most
# frames cost no sort of the window.
_REGULAR = (
    0.2  # relative: an interval this near the period is one period, however the estimate changes
)
# Intervals before the period is trusted: about a second; then all of them are judged together.
_FIRST = 24


class FrameGaps:
    """A counter of the frames missing between consecutive time stamps, given the measured period.

    Cameras run at another rate than the stated one. The period is the sum of the last 64 intervals
    over the number of periods in them, starting from their lower quartile; 0 before the first. It
    holds while less than a third of the frames are lost and the stamps are off by less than 15 % of
    the period. A camera that halves its rate looks like one that loses every second frame until the
    window has been replaced.
    """

    def __init__(self) -> None:
        self._intervals_ns: deque[int] = deque(maxlen=_WINDOW)
        self._last_ns: int | None = None
        self._judged = False
        self._until_measured = 0  # regular intervals
        self.period_ns = 0.0

    def add(self, t_ns: int) -> int:
        """Add the next frame's time stamp (ns, any origin);
        return how many lost frames it revealed.

        A time stamp that does not advance is ignored.
        """
        last_ns, self._last_ns = self._last_ns, t_ns
        if last_ns is None or t_ns <= last_ns:
            return 0
        interval_ns = t_ns - last_ns
        self._intervals_ns.append(interval_ns)
        self._until_measured -= 1
        if (
            self._until_measured > 0
            and abs(interval_ns - self.period_ns) < _REGULAR * self.period_ns
        ):
            return 0
        self.period_ns = period_ns = _period_ns(sorted(self._intervals_ns))
        if len(self._intervals_ns) < _FIRST:
            return 0
        self._until_measured = _WINDOW
        fresh = [interval_ns] if self._judged else list(self._intervals_ns)
        self._judged = True
        return sum(max(round(interval_ns / period_ns) - 1, 0) for interval_ns in fresh)


def _period_ns(ordered_ns: list[int]) -> float:
    # The lower quartile, not the median: it is still one period when every third frame is lost.
    period_ns = float(ordered_ns[len(ordered_ns) // 4])
    for _ in range(_ROUNDS):
        # In a sum of intervals the jitter cancels, except that of the first and the last stamp.
        period_ns = sum(ordered_ns) / sum(
            max(round(interval_ns / period_ns), 1) for interval_ns in ordered_ns
        )
    return period_ns


class Camera(ABC):
    """A `FrameSource` on a camera, whose `open` leaves the first frame in `_pending`.

    All methods belong to one thread, except `dropped` and `describe`.
    """

    def __init__(self, name: str, device: str) -> None:
        self._name, self._device = name, device
        self._pending: Frame | None = None
        # A camera that worked before and now offers less was unplugged, or another program changed
        # it: that may pass, so it is no ConfigError, for which the daemon would end.
        self._proven = False
        self._has_stamps = False  # the device's time stamps are CLOCK_MONOTONIC
        self._gaps = FrameGaps()
        self._seq = -1
        self._dropped = 0
        self._settings: dict[str, str | int | float] = {}

    @property
    def dropped(self) -> int:
        """Number of frames inferred lost from gaps in the time stamps, or undecodable,
        since the first open.
        """
        return self._dropped

    def read(self) -> Frame | None:
        """Wait for the next frame, at most about two seconds.

        Raises DeviceError when the device is lost or stalls.
        """
        frame, self._pending = self._pending, None
        return frame or self._next()

    def skip(self) -> bool:
        """Discard the next frame undecoded. Waits and raises as `read` does."""
        if self._pending is None:
            self._pass_over()
        self._pending = None
        return True

    def describe(self) -> dict[str, str | int | float]:
        """Return the requested and the actual settings;
        ``fps_measured`` is 0 until two frames have arrived.
        """
        period_ns = self._gaps.period_ns
        measured = round(1e9 / period_ns, 2) if period_ns else 0.0
        return {"device": self._device, **self._settings, "fps_measured": measured}

    @abstractmethod
    def _next(self) -> Frame: ...

    @abstractmethod
    def _pass_over(self) -> None: ...

    def _not_open(self) -> DeviceError:
        return DeviceError(f"{self._name}: not open")

    def _date(self, stamp_ns: int | None, now_ns: int) -> int:
        """Return the time stamp of a frame (ns); number it and count the frames lost before it."""
        t_ns, lost = now_ns, 0
        if self._has_stamps and stamp_ns is not None:
            lost = self._gaps.add(stamp_ns)
            # A driver may stamp ahead of the clock; a frame dated after its arrival would be
            # matched with a pose that is not there yet.
            t_ns = min(stamp_ns, now_ns)
        else:
            # Only for the measured rate: arrival is too uneven to reveal losses.
            self._gaps.add(now_ns)
        # A lost frame keeps its number, so that receivers see the gap.
        self._seq += 1 + lost
        self._dropped += lost
        return t_ns
