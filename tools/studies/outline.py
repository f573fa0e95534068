"""How well the network's outline and the paper's two means of the heights find a contact,
on the same maps.

::

    .venv/bin/python -m tools.studies.outline [--profile NAME...] [--sensors SEED,... | --final]
        [--objects NAME,...]
        [--references N] [--presses N] [--out DIR]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass
from functools import partial
from typing import get_args

from tacshade_edge.lab.studies.evaluate.accuracy import Figures, figures
from tacshade_edge.lab.studies.evaluate.score import Row, score
from tacshade_edge.lab.studies.evaluate.work import SensorName, family_of, press_cases, scenes
from tacshade_edge.lab.studies.markdown import grouped, summary
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, Outline, profile_with
from tacshade_edge.types import Calibration, Frame
from tools.studies import command
from tools.testbed.simulator.families import FINAL_SENSORS

SENSORS = "default,5,other:31,other:32"
FINAL = FINAL_SENSORS[::3]
"""One of each family: nothing was chosen by these figures."""


@dataclass(frozen=True, slots=True)
class OutlineRow(Row):
    """One frame with one profile and one outline."""

    outline: str


def rows(profiles: Sequence[str], task: tuple[SensorName, Calibration, str]) -> list[OutlineRow]:
    """Press an object on a sensor, and score each profile with each outline."""
    name, calibration, object_name = task
    sensor = name.make()
    made = [
        (outline, make_reconstructor(calibration, profile_with(profile, outline)))
        for profile in profiles
        for outline in get_args(Outline)
    ]
    pressed = scenes(sensor.model, name.seed, object_name)
    return [
        OutlineRow(
            *astuple(score(case.label, case.truth, each.step(Frame(0, 0, 0, case.image)))),
            outline=outline,
        )
        for case in press_cases(name, sensor, pressed)
        for outline, each in made
    ]


def _figure(
    outline: str, value: Callable[[Figures], float], spec: str
) -> Callable[[Sequence[OutlineRow]], str]:
    def figure(some: Sequence[OutlineRow]) -> str:
        return format(value(figures(row for row in some if row.outline == outline)), spec)

    return figure


MEASURES: dict[str, tuple[Callable[[Figures], float], str]] = {
    "ME mm": (lambda of: of.me_mm, ".3f"),
    "SD %": (lambda of: of.sd_pct, ".1f"),
    "IoU": (lambda of: of.iou, ".2f"),
    "missed": (lambda of: of.missed, "d"),
}
FIGURES: dict[str, Callable[[Sequence[OutlineRow]], str]] = {
    "presses": lambda some: str(len(some) // len(get_args(Outline))),
    **{
        f"{what}: {outline}": _figure(outline, value, spec)
        for what, (value, spec) in MEASURES.items()
        for outline in get_args(Outline)
    },
}


def text(found: Sequence[OutlineRow]) -> str:
    """A table of every profile on each family, and one of each object with the default profile."""
    profiles = [
        ((family, profile), some)
        for family, of in grouped(found, lambda row: family_of(row.sensor)).items()
        for profile, some in grouped(of, "profile").items()
    ]
    shown = DEFAULT if any(row.profile == DEFAULT for row in found) else found[0].profile
    objects = grouped((row for row in found if row.profile == shown), "object")
    return "\n\n".join(
        (
            "All objects",
            summary(("what", "method"), profiles, FIGURES),
            f"Each object, both families, {shown}",
            summary(("object",), [((name,), some) for name, some in objects.items()], FIGURES),
        )
    )


def main(words: Sequence[str] | None = None) -> None:
    """Run the study."""
    parser = command.options("The network's outline and the paper's.", SENSORS, FINAL)
    command.add_calibration(parser)
    args = parser.parse_args(words)
    command.check_presses(parser, args.presses)
    work = partial(
        command.over_sensors,
        partial(rows, args.profile),
        args.sensors,
        args.objects,
        fitted=args.fitted,
    )
    work = partial(work, references=args.references, presses=args.presses)
    command.run(parser, args, "outline", work, text, {"": OutlineRow})


if __name__ == "__main__":
    main()
