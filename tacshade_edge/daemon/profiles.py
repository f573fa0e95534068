"""The profile that runs and its reconstructor, and the choice of a profile that keeps a latency budget."""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any

from tacshade_edge.core.profiles import AUTO, LADDER, PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.observer import FrameObserver, FrameResult
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Calibration, Frame

WINDOW_FRAMES = 60
LATE_FRAMES = WINDOW_FRAMES // 10  # the budget applies to 90 % of the frames
MARGIN = 0.8  # a better profile is tried if it is expected to need at most this share of the budget
PATIENCE_S, LONGEST_PATIENCE_S = 30.0, 960.0
# A step up that does not last this many frames was a failed try: a minute at 30 frames a second.
TRIAL_FRAMES = 1800
STEPS_A_MINUTE = 6  # for a ladder of three: two tries, their returns, and two earlier steps down


@dataclass(frozen=True, slots=True)
class Step:
    """A change to another profile; the reason is ``OVER_BUDGET`` down, ``WITHIN_BUDGET`` up."""

    profile: str
    up: bool
    reason: Reason


@dataclass(frozen=True, slots=True)
class Standing:
    """How well a profile keeps the budget over its latest `WINDOW_FRAMES` frames.

    90 % of them took at most `within_ms`, None before the first; `kept` is None while there are too few to judge.
    """

    profile: str
    frames: int = 0
    within_ms: float | None = None
    kept: bool | None = None


class ProfileChooser:
    """Steps down a ladder of profiles as soon as a budget is not kept, and up slowly when a better one would keep it.

    After a failed try up the next one waits twice as long; whatever the noise, it takes at most `STEPS_A_MINUTE`. No
    clock and no thread. `costs_ms`, the most expensive profile first, are those of a step in contact on this idle
    machine; their ratios predict a better profile's time under load. Another thread may read `standing`.
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
        """Take a frame in contact into account, of which the reconstruction took `own_ms`.

        A frame of another `profile` than the chosen one began before the step. `now_s` never decreases.
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


_log = logging.getLogger(__name__)

REHEARSALS = 10
CALM_S = 60


@dataclass(frozen=True, slots=True)
class Stepped:
    """A step of a chooser that may have been replaced meanwhile."""

    chooser: ProfileChooser
    step: Step


class ActiveProfile(FrameObserver):
    """One profile, or `AUTO`: then all of `LADDER` are kept ready, so that a step builds nothing and waits for nothing.

    Only the main thread replaces `reconstructor`, which is a reason if there is no calibration: until there is one,
    `choose` only stores the choice. `report` is called in the reconstruct thread: pass its `Stepped` to `step`.
    """

    health_key = "budget"

    def __init__(
        self,
        reconstructor: Reconstructor | Reason,
        choice: str,
        budget_ms: float | None,
        report: Callable[[Stepped], None],
    ) -> None:
        self.reconstructor = reconstructor
        self._report = report
        self._kept: dict[str, Reconstructor] = {}
        self._chooser: ProfileChooser | None = None
        self._steps = {"steps_down": 0, "steps_up": 0}
        self._late_logged, self._calm_s = False, 0
        self.budget_ms = budget_ms
        self.choice = choice
        if not isinstance(reconstructor, Reason):
            self._install(choice, reconstructor.calibration, {reconstructor.profile.name: reconstructor})

    @property
    def name(self) -> str:
        """Name of the next frame's profile; without a calibration, the choice."""
        running = self.reconstructor
        return self.choice if isinstance(running, Reason) else running.profile.name

    @property
    def choices(self) -> tuple[str, ...]:
        return tuple(PROFILES) if self.budget_ms is None else (*PROFILES, AUTO)

    def choose(self, choice: str) -> None:
        """Use one of `choices`: a profile, or `AUTO` from its start."""
        self.choice, running = choice, self.reconstructor
        if not isinstance(running, Reason):
            self._install(choice, running.calibration, {})

    def use(self, calibration: Calibration | Reason) -> None:
        """Use another calibration and keep what `AUTO` has measured; before the first, why it is missing."""
        running = self.reconstructor
        if isinstance(calibration, Reason):
            self.reconstructor = calibration
        elif isinstance(running, Reason):
            self._install(self.choice, calibration, {})
        elif self._chooser is None:
            self.reconstructor = make_reconstructor(calibration, running.profile)
        else:
            self._kept = {name: make_reconstructor(calibration, PROFILES[name]) for name in LADDER}
            self.reconstructor = self._kept[self.name]

    def reload(self, choice: str, budget_ms: float | None, calibration: Calibration | Reason) -> None:
        unchanged = (choice, budget_ms) == (self.choice, self.budget_ms)
        self.budget_ms = budget_ms
        if unchanged or isinstance(calibration, Reason):
            self.choice = choice
            self.use(calibration)
        else:
            self._install(choice, calibration, {})

    def step(self, stepped: Stepped) -> bool:
        """Take a step; return False if its chooser was replaced."""
        if stepped.chooser is not self._chooser:
            return False
        step, before = stepped.step, self.name
        self.reconstructor = self._kept[step.profile]
        self._steps["steps_up" if step.up else "steps_down"] += 1
        to = f"{'up' if step.up else 'down'} to {step.profile}"
        _log.info("profile %s: stepped from %s %s: %s", AUTO, before, to, step.reason)
        return True

    def health(self) -> dict[str, Any] | None:
        """How well the budget is kept; None without `AUTO`."""
        if self._chooser is None:
            return None
        standing = self._chooser.standing
        within_ms = None if standing.within_ms is None else round(standing.within_ms, 3)
        return {
            "latency_budget_ms": self.budget_ms,
            "profile": self.name,
            "kept": standing.kept,
            "p90_ms": within_ms,
            **self._steps,
        }

    def see(self, seen: FrameResult) -> None:
        if self._chooser is not None and (made := seen.reconstruction) is not None and made.contact:
            now_ns = time.monotonic_ns()
            self.observe(made.profile, now_ns, (now_ns - seen.frame.t_ns) / 1e6, seen.step_ms)

    def observe(self, profile: str, now_ns: int, latency_ms: float, own_ms: float) -> None:
        """Let `AUTO` judge a latency, including `own_ms` of reconstruction."""
        chooser = self._chooser
        if chooser is not None and (step := chooser.observe(profile, now_ns / 1e9, latency_ms, own_ms)) is not None:
            self._report(Stepped(chooser, step))

    def log_late(self) -> None:
        """Log that even the fastest profile misses the budget, again only after `CALM_S`; call it once a second."""
        if self._chooser is None or (within_ms := self._chooser.standing.within_ms) is None:
            return
        budget_ms, late = self._chooser.budget_ms, self._chooser.standing.kept is False
        self._calm_s = 0 if late else self._calm_s + 1
        if self._calm_s >= CALM_S:
            self._late_logged = False
        if late and self._chooser.lowest and not self._late_logged:
            self._late_logged = True
            profile = self._chooser.profile
            found = "%s, the fastest profile, misses the budget of %g ms: 90 %% of frames took up to %.1f ms"
            _log.warning(found, profile, budget_ms, within_ms)

    def _install(self, choice: str, calibration: Calibration, ready: dict[str, Reconstructor]) -> None:
        """Use `choice`, with `ready` reconstructors, which no other thread may use: they are rehearsed here."""
        self.choice, self._late_logged, self._calm_s = choice, False, 0
        self._chooser = None
        if choice != AUTO or self.budget_ms is None:
            self._kept = {}
            self.reconstructor = ready.get(choice) or make_reconstructor(calibration, PROFILES[choice])
            return
        self._kept = {name: ready.get(name) or make_reconstructor(calibration, PROFILES[name]) for name in LADDER}
        costs_ms = {name: step_cost_ms(made) for name, made in self._kept.items()}
        chooser = ProfileChooser(self.budget_ms, costs_ms)
        self.reconstructor = self._kept[chooser.profile]
        self._chooser = chooser
        costs = ", ".join(f"{name} {ms:.1f} ms" for name, ms in costs_ms.items())
        start = "profile %s: starting with %s for a budget of %g ms; measured costs: %s"
        _log.info(start, AUTO, chooser.profile, self.budget_ms, costs)


def step_cost_ms(reconstructor: Reconstructor) -> float:
    """Approximate duration of a step in contact here, ms: the least of several runs of preprocessing and solver."""
    image = reconstructor.calibration.reference_grey
    frame = Frame(seq=0, t_ns=0, wall_ns=0, image=image)
    took_ns = []
    for _ in range(REHEARSALS):
        begin_ns = time.monotonic_ns()
        reconstructor.step(frame)
        reconstructor.depth(image)
        took_ns.append(time.monotonic_ns() - begin_ns)
    return min(took_ns) / 1e6
