"""Which profile keeps a latency budget: no clock, no thread; it is given what each frame took.

Down is quick: as soon as more than a tenth of a window of frames is late. Up is slow: a full window must leave room for
the better profile, and after a try that failed the next waits twice as long. So whatever the noise, there are at most
`STEPS_A_MINUTE` steps in any minute.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median

from tacshade_edge.reasons import Reason, ReasonCode

WINDOW_FRAMES = 60
LATE_FRAMES = WINDOW_FRAMES // 10  # the budget is one for 90 % of the frames
MARGIN = 0.8  # a better profile is tried when it is expected to need no more of the budget
PATIENCE_S, LONGEST_PATIENCE_S = 30.0, 960.0
# A profile that was stepped up to and did not last so many frames was a failed try: a minute at 30 a second.
TRIAL_FRAMES = 1800
STEPS_A_MINUTE = 6  # for a ladder of three: two tries, their returns, and two steps down from before


@dataclass(frozen=True, slots=True)
class Step:
    """A change of profile.

    Attributes
    ----------
    profile : str
        The one to change to.
    up : bool
        To a dearer one.
    reason : Reason
        ``OVER_BUDGET`` down, ``WITHIN_BUDGET`` up.
    """

    profile: str
    up: bool
    reason: Reason


@dataclass(frozen=True, slots=True)
class Standing:
    """How the present profile does, over its latest `WINDOW_FRAMES` frames.

    Attributes
    ----------
    profile : str
    frames : int
    within_ms : float or None
        90 % of the frames took no longer; None before the first.
    kept : bool or None
        Whether 90 % were within the budget; None while they are too few to judge.
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
        For 90 % of the frames.
    costs_ms : mapping
        What a step in contact takes on this machine when it is idle, of each profile, the dearest first. The ratios
        predict what a better one would take under a load; the first chosen is the dearest that `MARGIN` allows.

    Attributes
    ----------
    profile : str
        The one chosen.
    standing : Standing
        A new one after each frame, so that another thread may read it.
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
            What it was reconstructed with; a frame of another than the chosen one began before the step.
        now_s : float
            Never less than the last time.
        latency_ms : float
            What the budget is about.
        own_ms : float
            The part of it that the reconstruction took.

        Returns
        -------
        Step or None
            `profile` is then the new one already.
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
            text = f"{late} of the latest {frames} frames in contact took over {self.budget_ms:g} ms"
            return self._step(self._ladder[at + 1], now_s, Reason(ReasonCode.OVER_BUDGET, text))
        if not full:
            return None
        if at == 0 or now_s - self._since_s < self._patience_s[self._ladder[at - 1]]:
            return None
        expected_ms = self._expected_ms(self._ladder[at - 1], within_ms)
        if expected_ms > MARGIN * self.budget_ms:
            return None
        text = (
            f"90 % of {frames} frames took up to {within_ms:.1f} ms; the next profile should take {expected_ms:.1f} ms"
        )
        return self._step(self._ladder[at - 1], now_s, Reason(ReasonCode.WITHIN_BUDGET, text))

    def _expected_ms(self, better: str, within_ms: float) -> float:
        """What 90 % of the frames would take with a better profile: a load that slows this one slows that one too."""
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
        """Know nothing of the chosen profile yet."""
        self._frames = 0
        self._latency_ms: deque[float] = deque(maxlen=WINDOW_FRAMES)
        self._own_ms: deque[float] = deque(maxlen=WINDOW_FRAMES)
        self.standing = Standing(self.profile)
