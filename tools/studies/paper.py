"""The paper's two experiments on simulated sensors, beside its own figures.

::

    .venv/bin/python -m tools.studies.paper [--sensors default,5,other:31 | --final]
        [--states STATES] [--out DIR]

Experiment 1: Table I's five objects, by the paper's method with each press's own α (section IV-C),
by the same without eq. 11 and with an eq. 9 that saturates, as a user gets it, and by the networks.
``--states`` adds the third family (tools/studies/third_family/solve.py with ``--table-i``).
``--out`` also draws paper.png. Experiment 2 is tools.studies.paper_pad.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from tacshade_edge.cli.shared import study
from tacshade_edge.lab.parallel import Report, Workers
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.studies.evaluate.accuracy import PAPER_ROW, TABLE_I
from tacshade_edge.lab.studies.evaluate.score import score, score_cloud
from tacshade_edge.lab.studies.evaluate.work import Case, SensorName, family_of, press_cases, scenes
from tacshade_edge.lab.studies.markdown import grouped, markdown
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Calibration, Frame
from tools.studies import command
from tools.studies.paper_readings import PaperMapper, Reading
from tools.studies.paper_sheet import sheet
from tools.studies.third_family.table_i import third_family
from tools.testbed.simulator.families import FINAL_SENSORS

DEPTH_MM = 3.0
"""Depth of every press; the paper states a "consistent depth"."""
SHIPPED = "paper, as shipped"
BY_OWN_RATIO = {
    "paper, own α": (True, False),
    "own α, no eq. 11": (False, False),
    "own α, eq. 9 from 0": (True, True),
}
"""Methods with each press's own α: whether eq. 11 makes the heights, and whether eq.
9 saturates at 0.
"""
METHODS = (*BY_OWN_RATIO, SHIPPED, *command.NETWORKS)


@dataclass(frozen=True, slots=True)
class Judged:
    """One press judged by one method; each attribute is a column of paper.csv."""

    method: str
    sensor: str
    object: str
    true_depth_mm: float
    me_mm: float
    sd_pct: float
    sd_sum_pct: float


def judged(calibration: Calibration, cases: Sequence[Case]) -> list[Judged]:
    """Judge presses by every method."""
    mapper = PaperMapper(calibration, Reading().profile)
    usual = {
        SHIPPED: make_reconstructor(calibration, PROFILES["paper"]),
        **{name: make_reconstructor(calibration, PROFILES[name]) for name in command.NETWORKS},
    }
    found = []
    for case in cases:
        maps, depth_mm = mapper.maps(case.image), case.truth.depth_max_mm
        for method, (eq_11, saturates) in BY_OWN_RATIO.items():
            made = mapper.made(maps, depth_mm, eq_11=eq_11, saturates=saturates)
            cloud = score_cloud(made.points_mm, case.truth.points_mm, depth_mm)
            found.append(_row(method, case, cloud.me_mm, 100 * cloud.sd, 100 * cloud.sd_sum))
        for method, each in usual.items():
            row = score(case.label, case.truth, each.step(Frame(0, 0, 0, case.image)))
            found.append(_row(method, case, row.me_mm, row.sd_pct, row.sd_sum_pct))
    return found


def _row(method: str, case: Case, me_mm: float, sd_pct: float, sd_sum_pct: float) -> Judged:
    """A contact that is not found counts as untouched skin:
    its ME is the true depth, its SD is 0.
    """
    label, depth_mm = case.label, case.truth.depth_max_mm
    if math.isnan(me_mm):
        me_mm = depth_mm
    return Judged(method, label.sensor, label.object, depth_mm, me_mm, sd_pct, sd_sum_pct)


def pressed(task: tuple[SensorName, Calibration, str]) -> list[Judged]:
    """Press one object into a sensor: in the middle, next to it or well off it,
    in turn from seed to seed.
    """
    name, calibration, object_name = task
    sensor = name.make()
    where = scenes(sensor.model, name.seed, object_name, (DEPTH_MM,))
    scene = where[(name.seed or 0) % len(where)]
    return judged(calibration, list(press_cases(name, sensor, [scene])))


def rows(
    sensors: Sequence[SensorName], states: Path | None, pool: Workers, report: Report
) -> list[Judged]:
    """Judge every object on every sensor. Raises ConfigError and DeviceError."""
    made = command.over_sensors(pressed, sensors, PAPER_OBJECTS, pool, report)
    if states is not None:
        for calibration, cases in third_family(states):
            made += judged(calibration, cases)
    return made


def text(found: Sequence[Judged]) -> str:
    """Two tables for each family, ME and SD, with Table I in the first row."""
    parts = []
    for family, some in grouped(found, lambda row: family_of(row.sensor)).items():
        presses = len(some) // len(METHODS)
        head = f"Family {family}, {presses} presses"
        parts += [
            f"{head}: ME mm (eq. 13)",
            _table(some, lambda values: f"{np.mean([each.me_mm for each in values]):.3f}", ME),
            (
                f"{head}: SD % (eq. 14; d_CD as half the sum of both distances, "
                "in brackets as the sum)"
            ),
            _table(some, _sd_text, SD),
        ]
    return "\n\n".join(parts)


ME, SD = 0, 1
"""Places of the two measures in `TABLE_I`."""


def _sd_text(values: Sequence[Judged]) -> str:
    half, whole = (
        np.mean([getattr(each, name) for each in values]) for name in ("sd_pct", "sd_sum_pct")
    )
    return f"{half:.1f} ({whole:.1f})"


def _table(found: Sequence[Judged], cell: Callable[[Sequence[Judged]], str], measure: int) -> str:
    columns = [*((name,) for name in PAPER_OBJECTS), PAPER_OBJECTS]
    table_i = [np.mean([TABLE_I[name][measure] for name in names]) for names in columns]
    lines = [[PAPER_ROW, *(f"{value:.{1 if measure else 3}f}" for value in table_i)]]
    for method, some in grouped(found, "method").items():
        by_column = [[each for each in some if each.object in names] for names in columns]
        lines.append([method, *(cell(each) if each else "" for each in by_column)])
    return markdown(["method", *PAPER_OBJECTS, "mean"], lines)


def main(words: Sequence[str] | None = None) -> None:
    """Run Experiment 1."""
    parser = command.options(__doc__ or "", "default,5,21,other:31", FINAL_SENSORS)
    parser.add_argument(
        "--states", type=Path, metavar="STATES", help="of the third family, from solve --table-i"
    )
    args = parser.parse_args(words)
    work = partial(rows, args.sensors, args.states)
    command.run(parser, args, "paper", work, text, {"": Judged})
    if args.out:
        study.write(args.out / "paper.png", sheet())


if __name__ == "__main__":
    main()
