"""The jobs of the study: objects are loaded until they slide, or held and shaken."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from tacshade_edge.core.contact.margin import ALARM
from tacshade_edge.core.contact.tracking import ContactTracker, follow
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.drag import SLIDES
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.scene import SimulatedFrame, skin_under
from tacshade_edge.simulator.skin import Skin
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, SensorName, calibrate_sensors, reconstructor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import F64, U8, Calibration, Frame
from tools.testbed.simulator.families import other
from tools.testbed.simulator.motion import Motion, pressed
from tools.testbed.simulator.moving_scene import MovingScene
from tools.testbed.simulator.other_family import OtherSensor

FPS = 30
DEPTH_MM, FAR_MM = (1.5, 3.0), 9.0
"""Range of the presses' depths, and the longest path of a drag; on a skin of 20 mm."""
SETTLED_S, SEEN_S, AFTER_S = 0.45, 0.2, 0.3
"""How long an object rests before its load grows; how much the study sees of this rest, and after the slip's onset."""
REACH_S = (0.5, 2.0)
"""Least and greatest time from the start of a load to the slip."""
LOOSENED_PART = 0.55
"""Share of the drag to the slip by which an object is dragged before its grip is loosened."""
MOST_LIFTED = 0.9
"""Greatest lift, as a share of the depth."""
HELD_SHARE, SHAKEN_PART, SHAKEN_DEPTH = (0.3, 0.45), 0.25, 0.08
"""Share of the slip's load at which an object is held; shares of its drag and depth by which it is shaken."""
PERIOD = 24
"""Number of frames after which a disturbance repeats, with other noise."""


@dataclass(frozen=True, slots=True)
class Group:
    """Sensors and objects of one kind; None instead of a `coulomb` means the sensor's own."""

    name: str
    sensors: tuple[tuple[SensorName, float | None], ...]
    objects: tuple[str, ...]


def _usual(*seeds: int | None) -> tuple[tuple[SensorName, float | None], ...]:
    return tuple((SensorName("tacshade", seed), None) for seed in seeds)


GROUPS = (
    Group("as tuned on", _usual(None, 3), ("ball", "cube")),
    Group(
        "other friction",
        tuple((SensorName("tacshade", seed), mu) for seed, mu in ((7, 0.5), (10, 0.8), (23, 5.0))),
        ("ball", "cube"),
    ),
    Group("other objects", _usual(7, 10), ("cylinder", "cone")),
    Group("other mechanics", tuple((SensorName("other", seed), None) for seed in (5, 6)), ("ball", "cube")),
)

FINAL_GROUPS = (
    Group("usual", _usual(9021, 9022), ("ball", "cube")),
    Group(
        "other friction",
        tuple((SensorName("tacshade", seed), mu) for seed, mu in ((9021, 0.5), (9022, 0.8), (9023, 5.0))),
        ("ball", "cube"),
    ),
    Group("other objects", _usual(9021, 9023), ("cylinder", "cone")),
    Group("other mechanics", tuple((SensorName("other", seed), None) for seed in (9021, 9022)), ("ball", "cube")),
)
"""Groups that nobody evaluated while choosing the margin's rules."""


@dataclass(frozen=True, slots=True)
class Plan:
    """The parameters of a study; equal plans give equal rows. `held_s` is shared by all held objects of a group."""

    profile: str
    groups: tuple[Group, ...] = GROUPS
    held_s: float = 600.0


@dataclass(frozen=True, slots=True)
class LoadRow:
    """An object that is loaded until it slides; each attribute is a column of margin_loads.csv.

    Attributes
    ----------
    group, sensor, object, load : str
        `load` is ``pulled``, or ``loosened``: the depth falls under a constant drag.
    coulomb, reach_s : float
        The model's coefficient, and the time from the start of the load to the slip, without creep.
    onset_s, alarm_s : float
        When the whole contact truly slides, and when the margin first was at most `ALARM`; NaN: never.
    stuck : float
        Share of the contact that truly sticks at the alarm.
    """

    group: str
    sensor: str
    object: str
    load: str
    coulomb: float
    reach_s: float
    onset_s: float
    alarm_s: float
    stuck: float


@dataclass(frozen=True, slots=True)
class HeldRow:
    """An object that is held and shaken; each attribute is a column of margin_held.csv."""

    group: str
    sensor: str
    object: str
    coulomb: float
    held_s: float
    alarms: int
    least_margin: float
    least_stuck: float


Row = LoadRow | HeldRow
_Task = tuple[Plan, Group, SensorName, float | None, Calibration, str]


def study(plan: Plan, workers: Workers, report: Report) -> tuple[Row, ...]:
    """Run a plan. Raises ConfigError (a sensor cannot be calibrated) and DeviceError (a worker was killed)."""
    names = list(dict.fromkeys(name for group in plan.groups for name, _ in group.sensors))
    found = dict(zip(names, calibrate_sensors(names, REFERENCES, PRESSES, workers, report), strict=True))
    tasks: list[_Task] = [
        (plan, group, name, coulomb, found[name].calibration, what)
        for group in plan.groups
        for name, coulomb in group.sensors
        for what in group.objects
    ]
    return tuple(chain.from_iterable(reported_map(_rows, tasks, workers, report, "objects that are loaded and held")))


class _Drawn:
    """A sensor under one moving object, drawn without the camera's noise; skin of the other family does not creep."""

    def __init__(self, name: SensorName, coulomb: float | None) -> None:
        model = name.make().model
        self.model = model if coulomb is None else replace(model, coulomb=coulomb)
        self._quiet = replace(self.model, read_noise_grey=0.0, shot_noise_grey=0.0)
        self._other = None if name.family == "tacshade" else other(name.seed).noiseless()
        self._camera = Renderer(self.model)

    def frames(self, motion: Motion) -> Callable[[float], SimulatedFrame]:
        """Return a function that draws a motion's frame at a time in s."""
        return MovingScene([motion], self._quiet).frame if self._other is None else partial(_at, self._other, motion)

    def slides(self, press: Press) -> bool:
        """Whether the whole object slides in this press."""
        return _stuck(self._skin(press)) <= SLIDES

    def carried_mm(self, press: Press) -> float:
        """How far the object pulled the skin along on average, which measures its load in mm of skin."""
        (ahead,) = self._skin(press).slid_mm
        return math.hypot(press.drag_x_mm - ahead[0], press.drag_y_mm - ahead[1])

    def _skin(self, press: Press) -> Skin:
        return skin_under(self.model, [press]) if self._other is None else self._other.frame([press]).skin

    def exposed(self, drawn: SimulatedFrame, seed: int) -> U8:
        """Add the camera's noise to a frame's image."""
        return self._camera.expose(drawn.image[..., 1].astype(np.float32), seed)  # the gain of green is 1


def _at(sensor: OtherSensor, motion: Motion, t_s: float) -> SimulatedFrame:
    return sensor.frame([press for press in (motion.at(t_s),) if press is not None])


def _stuck(skin: Skin) -> float:
    return skin.stuck[0] if skin.stuck else 1.0


def _rows(task: _Task) -> list[Row]:
    plan, group, name, coulomb, calibration, what = task
    drawn, made = _Drawn(name, coulomb), reconstructor(calibration, plan.profile)
    rng = np.random.default_rng((0 if name.seed is None else name.seed + 1, 47, *what.encode(), *group.name.encode()))
    label, rows = (group.name, str(name), what), list[Row]()
    for load in ("pulled", "loosened", "held"):
        begun, way_mm = _begun(drawn, what, rng)
        reach_mm, reach_s = (
            way_mm * _least(drawn, begun.presses[-1], partial(_along, way_mm)),
            float(rng.uniform(*REACH_S)),
        )
        if not np.isfinite(reach_mm).all():
            continue
        if load == "held":
            held_s = plan.held_s / (len(group.sensors) * len(group.objects))
            rows.append(_held(drawn, made, label, _shaken(drawn, begun, reach_mm, rng), held_s))
            continue
        if load == "pulled":
            x, y = way_mm.tolist()
            motion: Motion | None = begun.dragged(x, y, float(np.linalg.norm(reach_mm)) / reach_s)
        else:
            motion = _loosened(drawn, begun, reach_mm, reach_s)
        if motion is not None:
            rows.append(_loaded(drawn, made, (*label, load), motion, reach_s))
    return rows


def _begun(drawn: _Drawn, what: str, rng: np.random.Generator) -> tuple[Motion, F64]:
    """Press an object next to the tip and let it rest; also return the longest path across the tip, in mm."""
    scale, angle = drawn.model.skin_radius_mm / 20, rng.uniform(0, 2 * math.pi)
    way = scale * np.array((math.cos(angle), math.sin(angle)))
    x, y = (-rng.uniform(1, 3) * way).tolist()
    press = Press(OBJECTS[what](), x, y, scale * rng.uniform(*DEPTH_MM), rng.uniform(0, 360), scale)
    return pressed(press, 0.0, 20.0).held(SETTLED_S), FAR_MM * way


def _moved(press: Press, drag_mm: F64, depth: float) -> Press:
    """Drag a press and multiply its depth by `depth`."""
    x, y = drag_mm.tolist()
    return replace(
        press, x_mm=press.x_mm + x, y_mm=press.y_mm + y, drag_x_mm=x, drag_y_mm=y, depth_mm=press.depth_mm * depth
    )


def _along(way_mm: F64, press: Press, part: float) -> Press:
    return _moved(press, part * way_mm, 1.0)


def _lifted(drag_mm: F64, press: Press, part: float) -> Press:
    return _moved(press, drag_mm, 1 - MOST_LIFTED * part)


def _least(drawn: _Drawn, press: Press, at: Callable[[Press, float], Press]) -> float:
    """Find the least part of a load, to a hundredth, at which the object slides; infinity if it never slides."""
    first = bisect_left(range(1, 101), True, key=lambda part: drawn.slides(at(press, part / 100)))
    return (first + 1) / 100 if first < 100 else math.inf


def _loosened(drawn: _Drawn, begun: Motion, reach_mm: F64, reach_s: float) -> Motion | None:
    """Drag an object by part of the way to the slip, then lift it until it slides; None if it would leave the skin."""
    last, drag_mm = begun.presses[-1], LOOSENED_PART * reach_mm
    lift = _least(drawn, last, partial(_lifted, drag_mm))
    if lift > 0.95:
        return None
    x, y = drag_mm.tolist()
    held, end = begun.dragged(x, y, 8.0).held(SETTLED_S), min(1.4 * lift, 1.0)
    end_s = held.times_s[-1] + reach_s * end / lift
    return Motion((*held.times_s, end_s), (*held.presses, _lifted(drag_mm, last, end)))


def _shaken(drawn: _Drawn, begun: Motion, reach_mm: F64, rng: np.random.Generator) -> Motion:
    """Load an object with part of the slip's load, then shake it along, across and in depth for two periods."""
    last, share = begun.presses[-1], rng.uniform(*HELD_SHARE)
    most_mm = drawn.carried_mm(_along(reach_mm, last, 1.0))
    part = bisect_left(range(1, 100), share * most_mm, key=lambda k: drawn.carried_mm(_along(reach_mm, last, k / 100)))
    drag_mm = (part + 1) / 100 * reach_mm
    x, y = drag_mm.tolist()
    held = begun.dragged(x, y, 8.0)
    angles = rng.integers(1, 3, (3, 1)) * np.arange(2 * PERIOD + 1) * (2 * math.pi / PERIOD)
    along, across, deeper = np.sin(angles + rng.uniform(0, 2 * math.pi, (3, 1)))
    drags = (1 + SHAKEN_PART * along)[:, None] * drag_mm + SHAKEN_PART * across[:, None] * drag_mm[::-1] * (-1, 1)
    times = held.times_s[-1] + 0.1 + np.arange(2 * PERIOD + 1) / FPS
    shaken = (_moved(last, drag, 1 + SHAKEN_DEPTH * more) for drag, more in zip(drags, deeper.tolist(), strict=True))
    return Motion((*held.times_s, *times.tolist()), (*held.presses, *shaken))


def _margins(made: Reconstructor, images: Iterable[U8], first: int) -> list[float]:
    """Compute each frame's least margin; 1 if nothing touches."""
    tracker = ContactTracker()
    results = [
        follow(tracker, made.step(Frame(k, round(1e9 * k / FPS), 0, image))) for k, image in enumerate(images, first)
    ]
    return [min((o.margin for o in result.objects if o.margin is not None), default=1.0) for result in results]


def _loaded(
    drawn: _Drawn, made: Reconstructor, label: tuple[str, str, str, str], motion: Motion, reach_s: float
) -> LoadRow:
    begin_s, frame = motion.times_s[-2], drawn.frames(motion)
    first, last = (math.ceil(FPS * t) for t in (begin_s - SEEN_S, motion.times_s[-1]))
    seen: list[SimulatedFrame] = []
    onset = last
    for k in range(first, last):
        seen.append(frame(k / FPS))
        if onset == last and k / FPS > begin_s and _stuck(seen[-1].skin) <= SLIDES:
            onset = k
        if k >= onset + AFTER_S * FPS:
            break
    images = (drawn.exposed(one, first + k) for k, one in enumerate(seen))
    low = np.flatnonzero(np.array(_margins(made, images, first)) <= ALARM)
    alarm_s, stuck = ((first + low[0]) / FPS, _stuck(seen[low[0]].skin)) if len(low) else (math.nan, math.nan)
    onset_s = onset / FPS if onset < last else math.nan
    return LoadRow(*label, drawn.model.coulomb, reach_s, onset_s, float(alarm_s), stuck)


def _held(drawn: _Drawn, made: Reconstructor, label: tuple[str, str, str], motion: Motion, held_s: float) -> HeldRow:
    frame = drawn.frames(motion)
    seen = [frame(t) for t in motion.times_s[-PERIOD - 1 : -1]]
    images = (drawn.exposed(seen[k % PERIOD], k) for k in range(round(held_s * FPS)))
    margins = np.array(_margins(made, images, 0))
    low = margins <= ALARM
    alarms = int(low[0]) + int(np.count_nonzero(low[1:] & ~low[:-1]))
    least_stuck = min(_stuck(one.skin) for one in seen)
    return HeldRow(*label, drawn.model.coulomb, held_s, alarms, float(margins.min()), least_stuck)
