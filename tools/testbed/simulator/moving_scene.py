"""A simulated sensor over time, with moving objects, a creeping skin, slowly changing light, and the truth.

Every result depends only on the time in seconds, so times may come in any order.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tacshade_edge.simulator.drag import contact_nodes, slip_of
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.scene import SimulatedFrame, skin_under
from tacshade_edge.simulator.skin import Skin, node_directions
from tacshade_edge.types import F32, Slip
from tools.testbed.simulator.creep import Imprint, imprint, kept, rest
from tools.testbed.simulator.motion import Motion
from tools.testbed.simulator.slow_light import SlowLight

_MEMORY_STEP_MM = 1.0
_JUMP_S = 1e-6
_ROUND_MM = 3  # digits, so that a skin that has stopped creeping is drawn once
_ROUND_PART = 4
_SPEED_SPAN_S = 0.02


@dataclass(frozen=True, slots=True)
class ObjectState:
    """The state of an object at one time; `press` is None while it is absent.

    The velocity is that of its lowest point along the sensor's axes, without creep; the turn is about z, from x towards
    y. `stuck` is the part of its contact in which the skin moves with it (1 without a contact); `slip` is full if the
    whole contact slides, or slid and then came to rest; `slip_mm_s` is relative to the skin, averaged over the contact.
    """

    press: Press | None
    touches: bool = False
    velocity_mm_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn_deg_s: float = 0.0
    stuck: float = 1.0
    slip: Slip | None = None
    slip_mm_s: float = 0.0


@dataclass(frozen=True, slots=True)
class _Moment:
    """Everything that determines the skin's shape; equal moments have equal skins.

    `loads` and `presses` are the present objects at their depths without and with creep, of the motions `owners`;
    `memory` are earlier loads, and the part of each that remains.
    """

    loads: tuple[Press, ...]
    presses: tuple[Press, ...]
    owners: tuple[int, ...]
    memory: tuple[tuple[tuple[Press, ...], float], ...]


class MovingScene:
    """Objects on a sensor, over time; the light may change. Equal time and noise seed give equal frames."""

    def __init__(
        self, motions: Sequence[Motion], model: SensorModel | None = None, light: SlowLight | None = None
    ) -> None:
        self.model = model or SensorModel()
        self.motions = tuple(motions)
        self._light = light
        self._renderer = Renderer(self.model)
        times = set[float]()
        for motion in self.motions:
            times.update(motion.steps_s(_MEMORY_STEP_MM))
            times.update((motion.times_s[0] - _JUMP_S, motion.times_s[-1] + _JUMP_S))
        self._times_s = tuple(sorted(times))
        self._loads = tuple(tuple(motion.at(t) for motion in self.motions) for t in self._times_s)
        self._skin = functools.lru_cache(maxsize=8)(self._shaped)
        self._elastic = functools.lru_cache(maxsize=64)(self._imprint)
        self._drawn = functools.lru_cache(maxsize=2)(self._drawing)

    def presses(self, t_s: float) -> tuple[Press, ...]:
        """List the presses on the skin at a time, at their depths with creep."""
        return self._moment(t_s).presses

    def skin(self, t_s: float) -> Skin:
        """Compute the skin's shape at a time."""
        return self._skin(self._moment(t_s))

    def frame(self, t_s: float, noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture. Raises ValueError: a press is not over the skin, or reaches the sensor's middle."""
        moment = self._moment(t_s)
        image = self._renderer.expose(self._drawn(moment), noise_seed)
        if self._light is not None:
            image = self._light.on(image, self.model, t_s)
        return SimulatedFrame(image, moment.presses, self._skin(moment), self.model)

    def objects(self, t_s: float) -> tuple[ObjectState, ...]:
        """Compute the true state of each motion's object, which takes as long as three frames."""
        times = tuple(t_s + k * _SPEED_SPAN_S for k in (-1, 0, 1))
        moments = [self._moment(t) for t in times]
        touching = [self._touching(moment) for moment in moments]
        states = []
        for k, motion in enumerate(self.motions):
            press, stuck, slip, speed = None, 1.0, None, 0.0
            if k in moments[1].owners:
                press = moments[1].presses[moments[1].owners.index(k)]
            if k in touching[1]:
                seen = [(t, self._slid_mm(m, k)) for t, m, on in zip(times, moments, touching, strict=True) if k in on]
                if len(seen) > 1:
                    speed = math.dist(seen[0][1], seen[-1][1]) / (seen[-1][0] - seen[0][0])
                stuck = self._stuck(moments[1], k)
                slip = slip_of(stuck)
            velocity, turn = motion.velocity(t_s, self.model.skin_radius_mm)
            states.append(ObjectState(press, k in touching[1], velocity, turn, stuck, slip, speed))
        return tuple(states)

    def _moment(self, t_s: float) -> _Moment:
        model = self.model
        weights = kept(self._times_s, t_s, model.creep_part, model.creep_s).tolist()
        loads, presses, owners = [], [], []
        for k, motion in enumerate(self.motions):
            load = motion.at(t_s)
            if load is not None:
                before = zip(weights, (then[k] for then in self._loads), strict=True)
                sunk = sum(w * max(press.depth_mm, 0.0) for w, press in before if press is not None)
                loads.append(load)
                presses.append(replace(load, depth_mm=load.depth_mm + round(sunk, _ROUND_MM)))
                owners.append(k)
        left = dict[tuple[Press, ...], float]()
        for weight, at in zip(weights, self._loads, strict=True):
            there = tuple(press for press in at if press is not None)
            left[there] = left.get(there, 0.0) + weight
        memory = tuple((there, part) for there, w in left.items() if there and (part := round(w, _ROUND_PART)) > 0)
        return _Moment(tuple(loads), tuple(presses), tuple(owners), memory)

    def _shaped(self, moment: _Moment) -> Skin:
        if not moment.memory:
            return skin_under(self.model, moment.presses)
        dragged = any(press.is_dragged for press in moment.loads)
        origin_mm = self._elastic(moment.loads).skin.origin_mm if dragged else None
        imprints = [self._elastic(loads) for loads, _ in moment.memory]
        left = rest(imprints, [part for _, part in moment.memory], self.model.skin_radius_mm, origin_mm)
        return skin_under(self.model, moment.presses, left)

    def _imprint(self, loads: tuple[Press, ...]) -> Imprint:
        return imprint(skin_under(self.model, loads))

    def _drawing(self, moment: _Moment) -> F32:
        return self._renderer.draw(self._skin(moment))

    def _touching(self, moment: _Moment) -> set[int]:
        skin = self._skin(moment)
        owner = contact_nodes(skin, node_directions(skin.radius_mm), moment.presses)[2]
        return {moment.owners[k] for k in set(owner.tolist())}

    def _slid_mm(self, moment: _Moment, k: int) -> tuple[float, float]:
        slid_mm = self._skin(moment).slid_mm
        return slid_mm[moment.owners.index(k)] if slid_mm else (0.0, 0.0)

    def _stuck(self, moment: _Moment, k: int) -> float:
        stuck = self._skin(moment).stuck
        return stuck[moment.owners.index(k)] if stuck else 1.0
