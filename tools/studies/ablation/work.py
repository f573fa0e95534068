"""The jobs of an ablation: every press of Experiment 1, with one cause of error after another removed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from tacshade_edge.core.calibration.refit.gain import LEAST_CELLS, PressRows, fit_factor
from tacshade_edge.core.depth.learned import LearnedSolver
from tacshade_edge.core.depth.network_maps import HEIGHT_SCALE
from tacshade_edge.core.image.preprocess import Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.inference.network import load_network
from tacshade_edge.simulator.objects import PAPER_OBJECTS
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.studies import tables
from tacshade_edge.studies.cases import press_label
from tacshade_edge.studies.evaluate.scenes import DEPTHS_MM, scenes
from tacshade_edge.studies.evaluate.score import KnownTruth, Label, Row, score
from tacshade_edge.studies.evaluate.sensors import PRESSES, REFERENCES, PressedSensor, SensorName, calibrated
from tacshade_edge.studies.evaluate.summary import by_object, figures, worst
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import F32, Bool, Calibration, Frame, Geometry
from tools.studies.ablation.perfected import PerfectedNetwork, true_answer
from tools.testbed.simulator.families import sensor_name
from tools.testbed.simulator.variants import noiseless


@dataclass(frozen=True, slots=True)
class Variant:
    """The parts that a variant makes perfect.

    Attributes
    ----------
    noiseless : bool
        The frame has no noise.
    calibrated : bool
        The geometry is the true one, and the factor on h is fitted to the true heights of the scored presses.
    top, height, contact : bool
        The truth replaces the network's greatest height (by scaling its map), all its heights (as integrated from the
        true gradient, from h = 0 at the rim), or its contact.
    """

    noiseless: bool = False
    calibrated: bool = False
    top: bool = False
    height: bool = False
    contact: bool = False


VARIANTS: Mapping[str, Variant] = {
    "as it is": Variant(),
    "frames without noise": Variant(noiseless=True),
    "perfect calibration": Variant(calibrated=True),
    "true greatest depth": Variant(top=True),
    "true outline": Variant(contact=True),
    "no noise, perfect calibration, true outline": Variant(noiseless=True, calibrated=True, contact=True),
    "true gradient": Variant(height=True),
    "true gradient and outline": Variant(height=True, contact=True),
}


@dataclass(frozen=True, slots=True)
class Plan:
    """The sensors and the learned profile of a study; the other attributes are those of `evaluate.work.Plan`."""

    sensors: tuple[SensorName, ...]
    profile: str = "accurate"
    objects: tuple[str, ...] = PAPER_OBJECTS
    references: int = REFERENCES
    presses: int = PRESSES
    depths_mm: tuple[float, ...] = DEPTHS_MM


@dataclass(frozen=True, slots=True)
class AblationRow:
    """The presses of one object on one sensor, by one variant.

    Attributes
    ----------
    sensor, object, what : str
        `what` is a key of `VARIANTS`.
    presses, missed : int
    me_mm, backward_mm, sd_pct, iou, depth_error_pct : float
        Means, as in `evaluate.summary.Figures`.
    """

    sensor: str
    object: str
    what: str
    presses: int
    missed: int
    me_mm: float
    backward_mm: float
    sd_pct: float
    iou: float
    depth_error_pct: float


@dataclass(frozen=True, slots=True, eq=False)
class _Pressed:
    """One press: its frame with the camera's noise and without, and its truth."""

    label: Label
    noisy: Frame
    clean: Frame
    simulated: SimulatedFrame
    truth: KnownTruth


def ablate(plan: Plan, workers: Workers, report: Report) -> tuple[tuple[str, Row], ...]:
    """Run a plan; return (variant, row) pairs. Raises ConfigError (a sensor cannot be calibrated) and DeviceError."""
    jobs = [(plan, name) for name in plan.sensors]
    return tuple(chain.from_iterable(reported_map(_sensor, jobs, workers, report, "sensors taken apart")))


def _sensor(task: tuple[Plan, SensorName]) -> list[tuple[str, Row]]:
    plan, name = task
    calibration = calibrated(name, plan.references, plan.presses).calibration
    sensor = name.make()
    pressed = list(chain.from_iterable(_presses(plan, name, sensor, what) for what in plan.objects))
    perfect = _perfectly_calibrated(plan, calibration, sensor.model.geometry, pressed)
    rows = []
    for what, variant in VARIANTS.items():
        used = perfect if variant.calibrated else calibration
        network = PerfectedNetwork(
            load_network(plan.profile), height=variant.height, contact=variant.contact, top=variant.top
        )
        reconstructor = Reconstructor(_unfitted(used, variant), PROFILES[plan.profile], network.as_network())
        for each in pressed:
            network.show(*true_answer(each.simulated, used.geometry, PROFILES[plan.profile].cells))
            result = reconstructor.step(each.clean if variant.noiseless else each.noisy)
            rows.append((what, score(each.label, each.truth, result)))
    return rows


def _unfitted(calibration: Calibration, variant: Variant) -> Calibration:
    """Remove the factors if the variant uses true heights, which need none."""
    return replace(calibration, factors={}) if variant.height or variant.top else calibration


def _presses(plan: Plan, name: SensorName, sensor: PressedSensor, object_name: str) -> list[_Pressed]:
    quiet = noiseless(sensor)
    made = []
    for scene in scenes(sensor.model, name.seed, object_name, plan.depths_mm):
        frame = sensor.frame((scene.press,), scene.noise_seed)
        clean = quiet.frame((scene.press,), scene.noise_seed).image
        truth = KnownTruth.of(frame.truth())
        made.append(
            _Pressed(press_label(name, scene), Frame(0, 0, 0, frame.image), Frame(0, 0, 0, clean), frame, truth)
        )
    return made


def _perfectly_calibrated(
    plan: Plan, calibration: Calibration, geometry: Geometry, pressed: Sequence[_Pressed]
) -> Calibration:
    true = replace(calibration, geometry=geometry)
    preprocessor = Preprocessor(true, PROFILES[plan.profile])
    solver = LearnedSolver(preprocessor, load_network(plan.profile))
    rows = []
    for each in pressed:
        inverse = solver.inverse(preprocessor.preprocess(preprocessor.grey(each.noisy.image)))
        height, contact = true_answer(each.simulated, geometry, PROFILES[plan.profile].cells)
        if (made := _rows_of(inverse.height_mm, height, contact, geometry)) is not None:
            rows.append(made)
    factor = fit_factor(rows)
    return replace(true, factors={} if factor is None else {plan.profile: factor})


def _rows_of(found_mm: F32, true: F32, contact: Bool, geometry: Geometry) -> PressRows | None:
    """Prepare one press for `fit_factor`, with weights that give every press the same influence."""
    use = contact & (found_mm > 0.05)
    cells = int(np.count_nonzero(use))
    if cells < LEAST_CELLS:
        return None
    unit_mm = geometry.skin_radius_mm * np.sin(np.radians(geometry.visible_half_angle_deg)) / HEIGHT_SCALE
    weight = 1 / np.sqrt(cells)
    return PressRows(found_mm[use].astype(np.float64) * weight, true[use].astype(np.float64) * unit_mm * weight)


def object_rows(found: Sequence[tuple[str, Row]]) -> list[AblationRow]:
    """Average over each object's presses, for the CSV file."""
    made = []
    for sensor in dict.fromkeys(row.sensor for _, row in found):
        for what in VARIANTS:
            some = [row for which, row in found if which == what and row.sensor == sensor]
            for name, of_object in by_object(some).items():
                made.append(
                    AblationRow(
                        sensor, name, what, of_object.presses, of_object.missed, of_object.me_mm,
                        of_object.backward_mm, of_object.sd_pct, of_object.iou, of_object.depth_error_pct,
                    )
                )  # fmt: skip
    return made


def text(found: Sequence[tuple[str, Row]]) -> str:
    """Write a table for each family."""
    parts = []
    for family in dict.fromkeys(sensor_name(row.sensor).family for _, row in found):
        lines = []
        for what in VARIANTS:
            some = [row for which, row in found if which == what and sensor_name(row.sensor).family == family]
            mean, least = figures(some), worst(list(by_object(some).values()))
            values = (mean.me_mm, least.me_mm, mean.backward_mm), (mean.sd_pct, least.sd_pct)
            lines.append(
                [
                    what,
                    *(f"{v:.3f}" for v in values[0]),
                    *(f"{v:.1f}" for v in values[1]),
                    f"{mean.iou:.2f}",
                    f"{mean.depth_error_pct:.1f}",
                ]
            )
        header = ["what", "ME mm", "worst object", "back mm", "SD %", "worst object", "IoU", "depth off %"]
        parts.append(f"Family {family}\n\n{tables.markdown(header, lines)}")
    return "\n\n".join(parts)
