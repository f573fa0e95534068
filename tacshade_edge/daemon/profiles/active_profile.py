"""The reconstructor that runs. Only the main thread replaces it; the reconstruct thread calls `see` and `observe`."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from tacshade_edge.core.profiles import AUTO, LADDER, PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.pipeline.observer import FrameObserver, FrameResult
from tacshade_edge.daemon.profiles.profile_chooser import ProfileChooser, Step
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason
from tacshade_edge.types import Calibration, Frame

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

    Parameters
    ----------
    reconstructor : Reconstructor or Reason
        The first one. A reason if there is no calibration: until there is one, `choose` only stores the choice.
    choice : str
        A key of `PROFILES`, or `AUTO`.
    budget_ms : float or None
        Budget that `AUTO` keeps; None if the settings have none.
    report : callable
        ``report(stepped)`` in the thread that reconstructs: pass `stepped` to `step` in the main thread.

    Attributes
    ----------
    reconstructor : Reconstructor or Reason
        The one for the next frame, or why there is none.
    choice : str
    budget_ms : float or None
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
        """The values that `choose` accepts."""
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
        """Apply the settings."""
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
        _log.info(
            "profile %s: stepped from %s %s to %s: %s",
            AUTO,
            before,
            "up" if step.up else "down",
            step.profile,
            step.reason,
        )
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
        """Let `AUTO` judge the latency of a contact."""
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
            _log.warning(
                "%s, the fastest profile, misses the budget of %g ms: 90 %% of frames took up to %.1f ms",
                profile,
                budget_ms,
                within_ms,
            )

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
        _log.info(
            "profile %s: starting with %s for a budget of %g ms; measured costs: %s",
            *(AUTO, chooser.profile, self.budget_ms, costs),
        )


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
