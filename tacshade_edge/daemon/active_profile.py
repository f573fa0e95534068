"""The profile that runs and its reconstructor, and the choice of a profile
that keeps a latency budget.
"""

from __future__ import annotations

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import median
from typing import Any

from tacshade_edge.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import AUTO, LADDER, PROFILES, Outline, profile_with
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import Calibration, Frame

WINDOW_FRAMES = 60
# The budget applies to 90 % of the frames.
LATE_FRAMES = WINDOW_FRAMES // 10
# A better profile is tried if it is expected to need at most this share of the budget.
MARGIN = 0.8
PATIENCE_S, LONGEST_PATIENCE_S = 30.0, 960.0
# A step up that does not last this many frames was a failed try: a minute at 30 frames a second.
TRIAL_FRAMES = 1800
# For a ladder of three: two tries, their returns, and two earlier steps down.
STEPS_A_MINUTE = 6


@dataclass(frozen=True, slots=True)
class Step:
    """A chooser's change to another profile; the reason is ``OVER_BUDGET`` down,
    ``WITHIN_BUDGET`` up.
    """

    chooser: ProfileChooser
    profile: str
    reason: Reason

    @property
    def up(self) -> bool:
        return self.reason.code is ReasonCode.WITHIN_BUDGET


@dataclass(frozen=True, slots=True)
class Standing:
    """How well the chosen profile keeps the budget over its latest `WINDOW_FRAMES` frames: 90 % of
    them took at most `within_ms`, None before the first; `kept` is None while there are too few to
    judge.
    """

    frames: int = 0
    within_ms: float | None = None
    kept: bool | None = None


class ProfileChooser:
    """Steps down a ladder of profiles as soon as a budget is not kept, and up slowly when a better
    one would keep it. After a failed try up the next one waits twice as long; whatever the noise,
    it takes at most `STEPS_A_MINUTE`. `costs_ms`, the most expensive profile first, are those of a
    step in contact on this idle machine. Another thread may read `standing`.
    """

    def __init__(self, budget_ms: float, costs_ms: Mapping[str, float]) -> None:
        self.budget_ms = budget_ms
        self._costs_ms = dict(costs_ms)
        self._ladder = tuple(costs_ms)
        fitting = (name for name, cost_ms in costs_ms.items() if cost_ms <= MARGIN * budget_ms)
        self._patience_s = dict.fromkeys(self._ladder, PATIENCE_S)
        self._trial, self._frames = False, 0
        self._since_s: float | None = None
        self._begin(next(fitting, self._ladder[-1]))

    @property
    def lowest(self) -> bool:
        """Whether no cheaper profile is left."""
        return self.profile == self._ladder[-1]

    def observe(self, profile: str, now_s: float, latency_ms: float, own_ms: float) -> Step | None:
        """Take a frame in contact into account, of which the reconstruction took `own_ms`; one of
        another `profile` than the chosen one began before the step. `now_s` never decreases.
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
        self.standing = Standing(
            frames, within_ms, False if late > LATE_FRAMES else True if full else None
        )
        at = self._ladder.index(profile)
        if late > LATE_FRAMES and not self.lowest:
            text = (
                f"{late} of the latest {frames} frames in contact took more than "
                f"{self.budget_ms:g} ms"
            )
            failed = self._trial and self._frames < TRIAL_FRAMES
            doubled_s = min(2 * self._patience_s[profile], LONGEST_PATIENCE_S)
            self._patience_s[profile] = doubled_s if failed else PATIENCE_S
            return self._step(
                Step(self, self._ladder[at + 1], Reason(ReasonCode.OVER_BUDGET, text)), now_s
            )
        better = self._ladder[max(at - 1, 0)]
        if not full or at == 0 or now_s - self._since_s < self._patience_s[better]:
            return None
        # A load slows both profiles alike.
        slower = self._costs_ms[better] / self._costs_ms[profile] - 1
        expected_ms = within_ms + slower * median(self._own_ms)
        if expected_ms > MARGIN * self.budget_ms:
            return None
        text = (
            f"90 % of {frames} frames took up to {within_ms:.1f} ms; "
            f"the next more accurate profile should take {expected_ms:.1f} ms"
        )
        return self._step(Step(self, better, Reason(ReasonCode.WITHIN_BUDGET, text)), now_s)

    def _step(self, step: Step, now_s: float) -> Step:
        self._trial = step.up
        self._begin(step.profile, now_s)
        return step

    def _begin(self, profile: str, now_s: float | None = None) -> None:
        """Begin with a profile, without measurements."""
        self.profile = profile
        self._since_s = now_s
        self._frames = 0
        self._latency_ms: deque[float] = deque(maxlen=WINDOW_FRAMES)
        self._own_ms: deque[float] = deque(maxlen=WINDOW_FRAMES)
        self.standing = Standing()


_log = logging.getLogger(__name__)

REHEARSALS = 10
# A budget that is missed now and then is reported once, not each time. journald could only count
# all lines of the service, and would drop others with these.
CALM_S = 60


class ActiveProfile(FrameObserver):
    """One profile, or `AUTO`: then all of `LADDER` are kept ready,
    so that a step builds nothing and waits for nothing.

    Only the main thread replaces `reconstructor`, which is a reason if there is no calibration:
    until there is one, `choose` only stores the choice. `report` is called in the reconstruct
    thread: pass its `Step` to `step`.
    """

    health_key = "budget"

    def __init__(
        self,
        reconstructor: Reconstructor | Reason,
        choice: str,
        budget_ms: float | None,
        outline: Outline,
        report: Callable[[Step], None],
    ) -> None:
        self.reconstructor = reconstructor
        self._report = report
        self._kept: dict[str, Reconstructor] = {}
        self._chooser: ProfileChooser | None = None
        self._steps = {"steps_down": 0, "steps_up": 0}
        self._late_logged, self._calm_s = False, 0
        self.budget_ms, self._outline = budget_ms, outline
        self.choice = choice
        if not isinstance(reconstructor, Reason):
            self._install(
                choice, reconstructor.calibration, {reconstructor.profile.name: reconstructor}
            )

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
        """Use another calibration and keep what `AUTO` has measured;
        before the first, why it is missing.
        """
        running = self.reconstructor
        if isinstance(calibration, Reason):
            self.reconstructor = calibration
        elif isinstance(running, Reason):
            self._install(self.choice, calibration, {})
        else:
            names = LADDER if self._chooser is not None else (running.profile.name,)
            self._kept = {name: self._made(calibration, name) for name in names}
            self.reconstructor = self._kept[running.profile.name]

    def reload(
        self,
        choice: str,
        budget_ms: float | None,
        outline: Outline,
        calibration: Calibration | Reason,
    ) -> None:
        unchanged = (choice, budget_ms) == (self.choice, self.budget_ms)
        self.choice, self.budget_ms, self._outline = choice, budget_ms, outline
        if unchanged or isinstance(calibration, Reason):
            self.use(calibration)
        else:
            self._install(choice, calibration, {})

    def step(self, step: Step) -> bool:
        """Take a step; return False if its chooser was replaced meanwhile."""
        # A request or a reload came between the step and this thread, and chose.
        if step.chooser is not self._chooser:
            return False
        # All of the ladder is kept, so a step under load costs nothing.
        before = self.name
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
        return {
            "latency_budget_ms": self.budget_ms,
            "profile": self.name,
            "kept": standing.kept,
            "p90_ms": None if standing.within_ms is None else round(standing.within_ms, 3),
            **self._steps,
        }

    def see(self, seen: FrameResult) -> None:
        if self._chooser is not None and (made := seen.reconstruction) is not None and made.contact:
            now_ns = time.monotonic_ns()
            self.observe(made.profile, now_ns, (now_ns - seen.frame.t_ns) / 1e6, seen.step_ms)

    def observe(self, profile: str, now_ns: int, latency_ms: float, own_ms: float) -> None:
        """Let `AUTO` judge a latency, including `own_ms` of reconstruction."""
        chooser = self._chooser
        if (
            chooser is not None
            and (step := chooser.observe(profile, now_ns / 1e9, latency_ms, own_ms)) is not None
        ):
            self._report(step)

    def log_late(self) -> None:
        """Log that even the fastest profile misses the budget, again only after `CALM_S`;
        call it once a second.
        """
        chooser = self._chooser
        if chooser is None or chooser.standing.within_ms is None:
            return
        late = chooser.standing.kept is False
        self._calm_s = 0 if late else self._calm_s + 1
        if self._calm_s >= CALM_S:
            self._late_logged = False
        if late and chooser.lowest and not self._late_logged:
            self._late_logged = True
            found = (
                "%s, the fastest profile, misses the budget of %g ms: "
                "90 %% of frames took up to %.1f ms"
            )
            _log.warning(found, chooser.profile, chooser.budget_ms, chooser.standing.within_ms)

    def _install(
        self, choice: str, calibration: Calibration, ready: dict[str, Reconstructor]
    ) -> None:
        """Use `choice`, with `ready` reconstructors, which no other thread may use:
        they are rehearsed here.
        """
        self.choice, self._late_logged, self._calm_s = choice, False, 0
        names = LADDER if choice == AUTO and self.budget_ms is not None else (choice,)
        # Built before `reconstructor` is replaced: the reconstruct thread goes on with the old
        # one, and no frame waits for the reading of a network.
        self._kept = {name: ready.get(name) or self._made(calibration, name) for name in names}
        if choice != AUTO or self.budget_ms is None:
            self._chooser = None
            self.reconstructor = self._kept[choice]
            return
        costs_ms = {name: step_cost_ms(made) for name, made in self._kept.items()}
        chooser = self._chooser = ProfileChooser(self.budget_ms, costs_ms)
        self.reconstructor = self._kept[chooser.profile]
        costs = ", ".join(f"{name} {ms:.1f} ms" for name, ms in costs_ms.items())
        start = "profile %s: starting with %s for a budget of %g ms; measured costs: %s"
        _log.info(start, AUTO, chooser.profile, self.budget_ms, costs)

    def _made(self, calibration: Calibration, name: str) -> Reconstructor:
        return make_reconstructor(calibration, profile_with(name, self._outline))


def step_cost_ms(reconstructor: Reconstructor) -> float:
    """Approximate duration of a step in contact here, ms: the least of several runs of
    preprocessing and solver.
    """
    image = reconstructor.calibration.reference_grey
    frame = Frame(seq=0, t_ns=0, wall_ns=0, image=image)
    took_ns = []
    for _ in range(REHEARSALS):
        begin_ns = time.monotonic_ns()
        reconstructor.step(frame)
        reconstructor.depth(image)
        took_ns.append(time.monotonic_ns() - begin_ns)
    # The least: whatever else runs at a start only adds to it.
    return min(took_ns) / 1e6
