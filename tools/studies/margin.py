"""Whether the margin announces a slip, and how often it is low while nothing slips.

::

    .venv/bin/python -m tools.studies.margin [--profile NAME] [--held SECONDS] [--final] [--out DIR]

Objects are loaded until they slide, or held and shaken.
"""

from __future__ import annotations

import argparse
import math
from bisect import bisect_left
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tacshade_edge.core.contact.tracking import ALARM, ContactTracker, follow
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.drag import SLIDES
from tacshade_edge.simulator.press import OBJECTS, Press
from tacshade_edge.simulator.render import Renderer
from tacshade_edge.simulator.skin import Skin
from tacshade_edge.simulator.truth import SimulatedFrame, skin_under
from tacshade_edge.studies.evaluate.work import SensorName, reconstructor
from tacshade_edge.studies.tables import grouped, summary
from tacshade_edge.types import F64, U8, Calibration, Frame
from tools.studies import command
from tools.testbed.simulator.families import OtherSensor, other
from tools.testbed.simulator.moving_scene import Motion, MovingScene, pressed

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
AHEAD_S = 0.1
"""Least time in s from an alarm to the onset of the slip that it announces."""


@dataclass(frozen=True, slots=True)
class Group:
    """Sensors and objects of one kind; None instead of a `coulomb` means the sensor's own."""

    name: str
    sensors: tuple[tuple[SensorName, float | None], ...]
    objects: tuple[str, ...]


def _usual(*seeds: int | None) -> tuple[tuple[SensorName, float | None], ...]:
    return tuple((SensorName("tacshade", seed), None) for seed in seeds)


def _groups(
    usual: Group, rubbed: tuple[int, int, int], others: tuple[int, int], mechanics: tuple[int, int]
) -> tuple[Group, ...]:
    friction = tuple((SensorName("tacshade", seed), mu) for seed, mu in zip(rubbed, (0.5, 0.8, 5.0), strict=True))
    return (
        usual,
        Group("other friction", friction, ("ball", "cube")),
        Group("other objects", _usual(*others), ("cylinder", "cone")),
        Group("other mechanics", tuple((SensorName("other", seed), None) for seed in mechanics), ("ball", "cube")),
    )


GROUPS = _groups(Group("as tuned on", _usual(None, 3), ("ball", "cube")), (7, 10, 23), (7, 10), (5, 6))
FINAL_GROUPS = _groups(
    Group("usual", _usual(9021, 9022), ("ball", "cube")), (9021, 9022, 9023), (9021, 9023), (9021, 9022)
)
"""Groups that nobody evaluated while choosing the margin's rules."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What begins every row (`Label`); `coulomb` is the model's coefficient."""

    group: str
    sensor: str
    object: str
    coulomb: float


@dataclass(frozen=True, slots=True)
class LoadRow(Seen):
    """An object that is loaded until it slides.

    `load` is ``pulled``, or ``loosened``: the depth falls under a constant drag. `reach_s` is the time from the start
    of the load to the slip, without creep, `onset_s` when the whole contact truly slides, `alarm_s` when the margin
    first was at most `ALARM` (NaN: never), and `stuck` the share of the contact that truly sticks at the alarm.
    """

    load: str
    reach_s: float
    onset_s: float
    alarm_s: float
    stuck: float


@dataclass(frozen=True, slots=True)
class HeldRow(Seen):
    """An object that is held and shaken."""

    held_s: float
    alarms: int
    least_margin: float
    least_stuck: float


Label = tuple[str, str, str, float]


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


def rows(profile: str, held_s: float, task: tuple[SensorName, Calibration, tuple[Group, str]]) -> list[Seen]:
    """Load and hold an object of a group on a sensor; all held objects of a group share `held_s`."""
    name, calibration, (group, what) = task
    held_s /= len(group.sensors) * len(group.objects)
    found: list[Seen] = []
    for coulomb in (mu for own, mu in group.sensors if own == name):
        drawn, made = _Drawn(name, coulomb), reconstructor(calibration, profile)
        label = (group.name, str(name), what, drawn.model.coulomb)
        found += _object_rows(drawn, made, label, 0 if name.seed is None else name.seed + 1, held_s)
    return found


def _object_rows(drawn: _Drawn, made: Reconstructor, label: Label, seed: int, held_s: float) -> Iterable[Seen]:
    group, _, what, _ = label
    rng = np.random.default_rng((seed, 47, *what.encode(), *group.encode()))
    for load in ("pulled", "loosened", "held"):
        begun, way_mm = _begun(drawn, what, rng)
        part = _least(drawn, begun.presses[-1], partial(_along, way_mm))
        reach_mm, reach_s = way_mm * part, float(rng.uniform(*REACH_S))
        if not np.isfinite(reach_mm).all():
            continue
        if load == "held":
            yield _held(drawn, made, label, _shaken(drawn, begun, reach_mm, rng), held_s)
            continue
        if load == "pulled":
            x, y = way_mm.tolist()
            motion: Motion | None = begun.dragged(x, y, float(np.linalg.norm(reach_mm)) / reach_s)
        else:
            motion = _loosened(drawn, begun, reach_mm, reach_s)
        if motion is not None:
            yield _loaded(drawn, made, label, load, motion, reach_s)


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


def _loaded(drawn: _Drawn, made: Reconstructor, label: Label, load: str, motion: Motion, reach_s: float) -> LoadRow:
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
    return LoadRow(*label, load, reach_s, onset_s, float(alarm_s), stuck)


def _held(drawn: _Drawn, made: Reconstructor, label: Label, motion: Motion, held_s: float) -> HeldRow:
    frame = drawn.frames(motion)
    seen = [frame(t) for t in motion.times_s[-PERIOD - 1 : -1]]
    images = (drawn.exposed(seen[k % PERIOD], k) for k in range(round(held_s * FPS)))
    margins = np.array(_margins(made, images, 0))
    low = margins <= ALARM
    alarms = int(low[0]) + int(np.count_nonzero(low[1:] & ~low[:-1]))
    least_stuck = min(_stuck(one.skin) for one in seen)
    return HeldRow(*label, held_s, alarms, float(margins.min()), least_stuck)


def _loads(some: Sequence[Seen]) -> list[LoadRow]:
    return [row for row in some if isinstance(row, LoadRow) and not math.isnan(row.onset_s)]


def _held_of(some: Sequence[Seen]) -> list[HeldRow]:
    return [row for row in some if isinstance(row, HeldRow)]


def _announced(loads: Sequence[LoadRow]) -> str:
    return f"{100 * np.mean([row.onset_s - row.alarm_s >= AHEAD_S - 1e-9 for row in loads]):.0f}" if loads else ""


def _median(values: Iterable[float], spec: str) -> str:
    known = [value for value in values if not math.isnan(value)]
    return format(np.median(known), spec) if known else ""


FIGURES: dict[str, Callable[[Sequence[Seen]], str]] = {
    "slips": lambda some: str(len(_loads(some))),
    "announced %": lambda some: _announced(_loads(some)),
    "median lead ms": lambda some: _median((1000 * (row.onset_s - row.alarm_s) for row in _loads(some)), ".0f"),
    "still stuck": lambda some: _median((row.stuck for row in _loads(some)), ".2f"),
    "minutes held": lambda some: f"{sum(row.held_s for row in _held_of(some)) / 60:.1f}",
    "false alarms": lambda some: str(sum(row.alarms for row in _held_of(some))),
    "least margin": lambda some: f"{min((row.least_margin for row in _held_of(some)), default=math.nan):.2f}",
}


def text(found: Sequence[Seen]) -> str:
    """A line for each group."""
    groups = [((name,), some) for name, some in grouped(found, "group").items()]
    return summary(("sensors and objects",), groups, FIGURES)


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description="The margin before a slip.")
    parser.add_argument("--profile", choices=command.NETWORKS, default="balanced", metavar="NAME")
    parser.add_argument("--held", type=float, default=600.0, metavar="SECONDS", help="over all held in a group (600)")
    parser.add_argument("--final", action="store_true", help="the sensors kept for final figures")
    command.add_output(parser)
    args = parser.parse_args(words)
    groups = FINAL_GROUPS if args.final else GROUPS
    sensors = tuple(dict.fromkeys(name for group in groups for name, _ in group.sensors))
    parts = [(group, what) for group in groups for what in group.objects]
    work = partial(command.over_sensors, partial(rows, args.profile, args.held), sensors, parts)
    command.run(parser, args, "margin", work, text, {"_loads": LoadRow, "_held": HeldRow})


if __name__ == "__main__":
    main()
