"""How far off shipped and fitted networks are on objects that were not pressed, and the tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, Label, score
from tacshade_edge.lab.studies.evaluate.work import (
    DEPTHS_MM,
    PressedSensor,
    Scene,
    SensorName,
    scenes,
)
from tacshade_edge.sensor.depth.sigma import INTERVAL_90
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import LADDER, PROFILES
from tacshade_edge.types import Calibration, Frame
from tools.studies.sigma import true_height_mm

BEYOND_MM = 6.0
"""Depth beyond the presses, mm: a third more than the deepest."""
DRAG_MM, DRAGGED_MM = 2.0, 3.0
"""Length of a drag, and depth during it, mm."""
JUDGED = ("pressed", "dragged", "beyond")
FIGURES = (
    "pressed",
    "dragged",
    f"{BEYOND_MM:g} mm deep",
    "worst object",
    "SD %",
    "IoU",
    "in 90 %",
    "in 90 % dragged",
)
"""Of each sensor: ME in mm by what was done and of the worst object, then of those not dragged,
and held shares.
"""


@dataclass(frozen=True, slots=True)
class Judged:
    """A frame under a profile, as shipped or fitted;
    NaN if nothing was found or there was nothing to find.
    """

    profile: str
    what: str
    object: str
    judged: str
    depth_mm: float
    me_mm: float
    sd_pct: float
    iou: float
    held_pct: float = math.nan
    """Share of the cells in contact whose 90 % interval holds the true height."""


def judged_scenes(sensor: PressedSensor, seed: int | None) -> list[tuple[str, Scene]]:
    """Table I's objects pressed as deep as the presses, deeper, and dragged."""
    made = []
    for thing in PAPER_OBJECTS:
        made += [("pressed", scene) for scene in scenes(sensor.model, seed, thing, DEPTHS_MM)]
        made += [("beyond", scene) for scene in scenes(sensor.model, seed, thing, (BEYOND_MM,))]
        for k, scene in enumerate(scenes(sensor.model, seed, thing, (DRAGGED_MM,))):
            x, y = DRAG_MM * math.cos(2.4 * k), DRAG_MM * math.sin(2.4 * k)
            made.append(
                ("dragged", replace(scene, press=replace(scene.press, drag_x_mm=x, drag_y_mm=y)))
            )
    return made


def judge(
    name: SensorName, sensor: PressedSensor, calibrations: Mapping[str, Calibration]
) -> list[Judged]:
    """Judge every scene with every profile and calibration."""
    made = [
        (what, p, make_reconstructor(c, PROFILES[p]))
        for what, c in calibrations.items()
        for p in LADDER
    ]
    rows = []
    for judged, scene in judged_scenes(sensor, name.seed):
        frame = sensor.frame((scene.press,), scene.noise_seed)
        truth = frame.truth()
        for what, profile, reconstructor in made:
            found = reconstructor.step(Frame(0, 0, 0, frame.image))
            scored = score(Label(str(name), scene.object_name), KnownTruth.of(truth), found)
            depth, contact, held_pct = scene.press.depth_mm, found.height.contact, math.nan
            if found.contact and found.sigma_mm is not None:
                off_mm = np.abs(
                    found.height.height_mm[contact]
                    - true_height_mm(frame, reconstructor.grid, contact)
                )
                held_pct = 100 * float(np.mean(off_mm <= INTERVAL_90 * found.sigma_mm[contact]))
            scores = (scored.me_mm, scored.sd_pct, scored.iou, held_pct)
            rows.append(Judged(profile, what, scene.object_name, judged, depth, *scores))
    return rows


def of_objects(rows: list[Judged], value: str) -> list[float]:
    """Each object's mean."""
    each = [[getattr(row, value) for row in rows if row.object == thing] for thing in PAPER_OBJECTS]
    return [float(np.nanmean(values)) for values in each]


def of_sensor(case: str, kept: Mapping[str, bool], rows: list[Judged]) -> list[list[str]]:
    """Lines of the table of each sensor, one for each profile."""
    lines = []
    for profile in LADDER:
        of_both = []
        for what in ("shipped", "fitted"):
            own = [row for row in rows if (row.profile, row.what) == (profile, what)]
            pressed, moved, deep = ([r for r in own if r.judged == judged] for judged in JUDGED)
            of_each = of_objects(pressed, "me_mm")
            me_mm = [
                np.mean(each)
                for each in (of_each, of_objects(moved, "me_mm"), of_objects(deep, "me_mm"))
            ]
            held = [np.nanmean([row.held_pct for row in some]) for some in (pressed, moved)]
            sd, iou = (np.mean(of_objects(pressed, value)) for value in ("sd_pct", "iou"))
            of_both.append(
                [
                    *(f"{me:.3f}" for me in (*me_mm, max(of_each))),
                    f"{sd:.1f}",
                    f"{iou:.2f}",
                    *(f"{h:.0f}" for h in held),
                ]
            )
        stays = "yes" if kept[profile] else "no"
        lines.append(
            [case, profile, stays, *(cell for pair in zip(*of_both, strict=True) for cell in pair)]
        )
    return lines


def changes(of_cases: Sequence[tuple[Mapping[str, bool], list[Judged]]]) -> list[list[str]]:
    """Lines of the table of changes: ME after the fit over that before;
    a fit that is not kept changes nothing.
    """
    lines = []
    for profile in LADDER:
        ratios: dict[str, list[float]] = {judged: [] for judged in JUDGED}
        for kept, rows in of_cases:
            for judged, of_judged in ratios.items():
                before, after = (
                    np.mean(
                        of_objects(
                            [
                                r
                                for r in rows
                                if (r.profile, r.judged, r.what) == (profile, judged, w)
                            ],
                            "me_mm",
                        )
                    )
                    for w in ("shipped", "fitted")
                )
                of_judged.append(float(after / before) if kept[profile] else 1.0)
        half = np.mean([ratios["pressed"], ratios["dragged"]], axis=0)
        cells = [
            cell
            for each in (ratios["pressed"], ratios["dragged"], half, ratios["beyond"])
            for cell in (f"{np.mean(each):.2f}", f"{max(each):.2f}")
        ]
        lines.append(
            [profile, f"{sum(kept[profile] for kept, _ in of_cases)} of {len(of_cases)}", *cells]
        )
    return lines
