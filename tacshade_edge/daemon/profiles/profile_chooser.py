"""Chooses the profile that keeps a latency budget: no clock, no thread; the caller passes in each frame's durations.

It steps down quickly, as soon as more than a tenth of a window of frames is late. It steps up slowly: a full window
must leave room for the better profile, and after a failed try the next one waits twice as long. Whatever the noise,
it takes at most `STEPS_A_MINUTE` steps in any minute.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from tacshade_edge.reasons import Reason, ReasonCode

WINDOW_FRAMES = 60
LATE_FRAMES = WINDOW_FRAMES // 10  # the budget applies to 90 % of the frames
MARGIN = 0.8  # a better profile is tried if it is expected to need at most this share of the budget
PATIENCE_S, LONGEST_PATIENCE_S = 30.0, 960.0
# A step up that does not last this many frames was a failed try: a minute at 30 frames a second.
TRIAL_FRAMES = 1800
STEPS_A_MINUTE = 6  # for a ladder of three: two tries, their returns, and two earlier steps down


@dataclass(frozen=True, slots=True)
class Step:
    """A change of profile.

    Attributes
    ----------
    profile : str
        The new profile.
    up : bool
        Whether it is more expensive.
    reason : Reason
        ``OVER_BUDGET`` down, ``WITHIN_BUDGET`` up.
    """

    profile: str
    up: bool
    reason: Reason


@dataclass(frozen=True, slots=True)
class Standing:
    """How well the present profile keeps the budget, over its latest `WINDOW_FRAMES` frames.

    Attributes
    ----------
    profile : str
    frames : int
    within_ms : float or None
        Latency that 90 % of the frames do not exceed; None before the first.
    kept : bool or None
        Whether 90 % are within the budget; None while there are too few to judge.
    """

    profile: str
    frames: int = 0
    within_ms: float | None = None
    kept: bool | None = None


class ProfileChooser:
    """Steps down a ladder of profiles when a latency budget is not kept, and up when a better one would keep it.

    Parameters
    ----------
    budget_ms : float
        Limit for 90 % of the frames.
    costs_ms : mapping
        Duration of a step in contact on this machine when it is idle, for each profile, the most expensive first. The
        ratios predict a better profile's time under load; the first choice is the most expensive that `MARGIN` allows.

    Attributes
    ----------
    profile : str
        The chosen one.
    standing : Standing
        Replaced after each frame, so that another thread may read it.
    """

    def __init__(self, budget_ms: float, costs_ms: Mapping[str, float]) -> None:
        self.budget_ms = budget_ms
        self._costs_ms = dict(costs_ms)
        self._ladder = tuple(costs_ms)
        fitting = (name for name, cost_ms in costs_ms.items() if cost_ms <= MARGIN * budget_ms)
        self.profile = next(fitting, self._ladder[-1])
        self._patience_s = dict.fromkeys(self._ladder, PATIENCE_S)
        self._since_s: float | None = None
        self._trial = False
        self._begin()

    @property
    def lowest(self) -> bool:
        """Whether no cheaper profile is left."""
        return self.profile == self._ladder[-1]

    def observe(self, profile: str, now_s: float, latency_ms: float, own_ms: float) -> Step | None:
        """Take a frame in contact into account.

        Parameters
        ----------
        profile : str
            Profile that reconstructed the frame; if it is not the chosen one, the frame began before the step.
        now_s : float
            Time, never less than in the last call.
        latency_ms : float
            Latency that the budget limits.
        own_ms : float
            The reconstruction's share of it.

        Returns
        -------
        Step or None
            After a step, `profile` is already the new one.
        """
        if profile != self.profile:
            return None
        if self._since_s is None:
            self._since_s = now_s
        self._frames += 1
        self._latency_ms.append(latency_ms)
        self._own_ms.append(own_ms)
        late = sum(ms > self.budget_ms for ms in self._latency_ms)
        frames = len(self._latency_ms)
        within_ms = sorted(self._latency_ms)[math.ceil(0.9 * frames) - 1]
        full = frames == WINDOW_FRAMES
        kept = False if late > LATE_FRAMES else (True if full else None)
        self.standing = Standing(profile, frames, within_ms, kept)
        at = self._ladder.index(profile)
        if kept is False and not self.lowest:
            text = f"{late} of the latest {frames} frames in contact took more than {self.budget_ms:g} ms"
            return self._step(self._ladder[at + 1], now_s, Reason(ReasonCode.OVER_BUDGET, text))
        if not full:
            return None
        if at == 0 or now_s - self._since_s < self._patience_s[self._ladder[at - 1]]:
            return None
        expected_ms = self._expected_ms(self._ladder[at - 1], within_ms)
        if expected_ms > MARGIN * self.budget_ms:
            return None
        text = (
            f"90 % of {frames} frames took up to {within_ms:.1f} ms; "
            f"the next more accurate profile should take {expected_ms:.1f} ms"
        )
        return self._step(self._ladder[at - 1], now_s, Reason(ReasonCode.WITHIN_BUDGET, text))

    def _expected_ms(self, better: str, within_ms: float) -> float:
        """Latency that 90 % of the frames would keep with a better profile: a load slows both profiles alike."""
        times = self._costs_ms[better] / self._costs_ms[self.profile]
        return within_ms + (times - 1) * median(self._own_ms)

    def _step(self, profile: str, now_s: float, reason: Reason) -> Step:
        up = reason.code is ReasonCode.WITHIN_BUDGET
        if not up:
            failed = self._trial and self._frames < TRIAL_FRAMES
            doubled_s = min(2 * self._patience_s[self.profile], LONGEST_PATIENCE_S)
            self._patience_s[self.profile] = doubled_s if failed else PATIENCE_S
        self.profile = profile
        self._trial = up
        self._since_s = now_s
        self._begin()
        return Step(profile, up, reason)

    def _begin(self) -> None:
        """Discard all measurements: the chosen profile is new."""
        self._frames = 0
        self._latency_ms: deque[float] = deque(maxlen=WINDOW_FRAMES)
        self._own_ms: deque[float] = deque(maxlen=WINDOW_FRAMES)
        self.standing = Standing(self.profile)
