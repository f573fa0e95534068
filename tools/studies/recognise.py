"""How often taught objects are named right on another sensor, and other objects called unknown.

::

    .venv/bin/python -m tools.studies.recognise [--profile NAME...] [--sensors SEED,... | --final]

Every sensor in turn is taught the objects of a set by some touches of each, and all others are
touched by these objects and by strangers, which nobody taught. No object and no sensor is among
those from which the metric was learned.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tacshade_edge.lab.parallel import Report, Workers
from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS, Shape
from tacshade_edge.lab.studies.evaluate.work import SensorName, one_thread
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.inference.object_names import load_metric
from tacshade_edge.sensor.recognition.answer import Recogniser
from tacshade_edge.sensor.recognition.metric import Metric
from tacshade_edge.types import F32, Calibration, KnownObject
from tools.studies import command
from tools.testbed.simulator.families import FINAL_SENSORS
from tools.testbed.simulator.household import HOUSEHOLD
from tools.testbed.simulator.object_touches import SeenTouches, draw_touch, see_touches

OTHERS = tuple(name for name in OBJECTS if name not in PAPER_OBJECTS)
SETS: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "Table I's five": (PAPER_OBJECTS, OTHERS),
    "twenty household objects": (tuple(HOUSEHOLD), tuple(OBJECTS)),
}
"""For each set, the objects that are taught, and the strangers."""
TOUCHES = 6  # of each object on each sensor
TAUGHT = 3
FORMS: dict[str, tuple[int, int]] = {
    "1 taught": (1, 1),
    "3 taught": (TAUGHT, 1),
    "5 taught": (5, 1),
    "3 taught, 3 touches together": (TAUGHT, 3),
}
"""How many touches teach an object, and how many answer together."""
FINAL = FINAL_SENSORS[:2] + FINAL_SENSORS[3:5]
CONFUSED = 3  # names that a row lists
REPEATED = 5  # times that descriptions are timed; the best counts, because others load the machine


@dataclass(frozen=True, slots=True)
class Described:
    """Descriptions (touches, D) of the touches of one object by one profile, and the time of each,
    ms.
    """

    sensor: str
    profile: str
    object: str
    descriptions: F32
    ms: float


@dataclass(frozen=True, slots=True)
class AnswerRow:
    """An answer; `name` is empty for unknown, `nearest` the likeliest object if none could be
    unknown.
    """

    set: str
    profile: str
    form: str
    taught_on: str
    sensor: str
    object: str
    stranger: bool
    name: str
    probability: float
    nearest: str


def describe(profiles: Sequence[str], task: tuple[SensorName, Calibration, str]) -> list[Described]:
    """Touch a sensor with one object."""
    name, calibration, object_name = task
    sensor, shape = name.make(), _shape(object_name)
    rng = np.random.default_rng((0 if name.seed is None else name.seed + 1, *object_name.encode()))
    presses = [draw_touch(rng, shape, sensor.model.skin_radius_mm) for _ in range(TOUCHES)]
    made = []
    with one_thread():
        seen = see_touches(sensor, calibration, presses, profiles)
        for profile, touches in seen.items():
            found = [each for each in touches.descriptions() if each is not None]
            ms = min(_timed_ms(touches) for _ in range(REPEATED))
            made.append(Described(str(name), profile, object_name, np.stack(found), ms))
    return made


def _timed_ms(touches: SeenTouches) -> float:
    """Processor time of a description, ms."""
    began_s = time.thread_time()
    touches.descriptions()
    return 1e3 * (time.thread_time() - began_s) / TOUCHES


def _shape(name: str) -> Shape:
    return HOUSEHOLD[name] if name in HOUSEHOLD else OBJECTS[name]()


Touches = Mapping[tuple[str, str, str], F32]  # by profile, sensor and object


def answers(described: Sequence[Described]) -> list[AnswerRow]:
    """Teach on each sensor, and ask on all others."""
    touches = {(d.profile, d.sensor, d.object): d.descriptions for d in described}
    sensors = list(dict.fromkeys(d.sensor for d in described))
    rows: list[AnswerRow] = []
    for set_name in SETS:
        for profile in dict.fromkeys(d.profile for d in described):
            for form in FORMS:
                for teacher in sensors:
                    who = set_name, profile, form, teacher
                    others = [each for each in sensors if each != teacher]
                    rows += _asked(touches, who, others)
    return rows


def _asked(
    touches: Touches, who: tuple[str, str, str, str], sensors: Sequence[str]
) -> Iterator[AnswerRow]:
    set_name, profile, form, teacher = who
    objects, strangers = SETS[set_name]
    count, together = FORMS[form]
    known = [KnownObject(name, touches[profile, teacher, name][:count]) for name in objects]
    metric = load_metric()
    recogniser, always = Recogniser(metric, known), Recogniser(_never_unknown(metric), known)
    for sensor in sensors:
        for name in (*objects, *strangers):
            seen = touches[profile, sensor, name]
            for first in range(0, len(seen) - together + 1, together):
                some = seen[first : first + together]
                answer, nearest = recogniser.answer(some), always.answer(some)
                yield AnswerRow(
                    *who,
                    sensor,
                    name,
                    name in strangers,
                    answer.name or "",
                    answer.probability or 0.0,
                    nearest.name or "",
                )


def _never_unknown(metric: Metric) -> Metric:
    return replace(metric, scores=np.full_like(metric.scores, -1e9))


def text(ms: Mapping[str, float], rows: Sequence[AnswerRow]) -> str:
    """The tables."""
    head = ["objects", "profile", "taught", "right %", "another name %", "unknown %"]
    head += ["nearest right %", "named: right %", "named: claimed %", "strangers unknown %"]
    lines = [[*who, *_figures(some)] for who, some in _grouped(rows)]
    times = [[profile, f"{each:.2f}"] for profile, each in ms.items()]
    whole = [
        markdown(head, lines),
        f"Processor time of a description, median of the best of {REPEATED} times",
        markdown(["profile", "ms"], times),
        "Each object, 3 taught",
        markdown(["object", "profile", "right %", "taken for"], _by_object(rows)),
    ]
    return "\n\n".join(whole)


def _grouped(
    rows: Sequence[AnswerRow],
) -> Iterator[tuple[tuple[str, str, str], list[AnswerRow]]]:
    found: dict[tuple[str, str, str], list[AnswerRow]] = {}
    for row in rows:
        found.setdefault((row.set, row.profile, row.form), []).append(row)
    yield from found.items()


def _figures(rows: Sequence[AnswerRow]) -> list[str]:
    known = [row for row in rows if not row.stranger]
    named = [row for row in known if row.name]
    right = [row.name == row.object for row in known]
    unknown = [not row.name for row in known]
    wrong = [bool(row.name) and row.name != row.object for row in known]
    parts = [right, wrong, unknown, [row.nearest == row.object for row in known]]
    parts.append([row.name == row.object for row in named])
    shares = [100 * float(np.mean(part)) for part in parts]
    shares.append(100 * float(np.mean([row.probability for row in named])))
    shares.append(100 * float(np.mean([not row.name for row in rows if row.stranger])))
    return [f"{share:.1f}" for share in shares]


def _by_object(rows: Sequence[AnswerRow]) -> list[list[str]]:
    found: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        if row.form == "3 taught" and not row.stranger:
            found.setdefault((row.object, row.profile), []).append(row.name or "unknown")
    lines = []
    for (name, profile), names in found.items():
        counts = Counter(each for each in names if each != name).most_common(CONFUSED)
        share = 100 * names.count(name) / len(names)
        taken = ", ".join(f"{other} {100 * n / len(names):.0f} %" for other, n in counts)
        lines.append([name, profile, f"{share:.0f}", taken])
    return lines


def main(words: Sequence[str] | None = None) -> None:
    """Study; print the tables."""
    parser = command.options("Recognition of taught objects.", "5,11,other:31", FINAL)
    args = parser.parse_args(words)
    ms: dict[str, float] = {}

    def work(pool: Workers, report: Report) -> list[AnswerRow]:
        described = command.over_sensors(
            partial(describe, tuple(args.profile)),
            args.sensors,
            (*HOUSEHOLD, *OBJECTS),
            pool,
            report,
            fitted=args.fitted,
        )
        for profile in args.profile:
            ms[profile] = float(np.median([d.ms for d in described if d.profile == profile]))
        return answers(described)

    command.run(parser, args, "recognise", work, partial(text, ms), {"": AnswerRow})


if __name__ == "__main__":
    main()
