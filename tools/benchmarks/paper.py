#!/usr/bin/env python3
"""What `paper` costs at strides of 1, 2 and 4 px, how near eq.
11 in float32 is to complex128, and how wrong it is.

::

    .venv/bin/python -m tools.benchmarks.paper [--sensors default,5,21] [--rounds 5]

Processor time of single-threaded 640x480 frames in contact: the median over frames and rounds.
*Off* compares heights of up to 3 mm with those of the published iteration
(`support.hybrid_sfs_oracle`) from the same g_hn; *rounding* is what the published iteration's
own heights change by if g_hn is rounded differently to float32. ME (eq. 13) takes each press's own
ratio as α.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from support.hybrid_sfs_oracle import unit_height
from tacshade_edge.lab.simulator.press import OBJECTS, PAPER_OBJECTS, Press
from tacshade_edge.lab.studies.evaluate.score import KnownTruth, score_cloud
from tacshade_edge.lab.studies.evaluate.work import calibrated
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.lab.studies.tradeoff.timing import Parts
from tacshade_edge.sensor.depth import with_own_ratio
from tacshade_edge.sensor.depth.hybrid_iteration import HybridIteration
from tacshade_edge.sensor.depth.hybrid_sfs import finite_shape_grey
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.image.preprocess import GreyMapper, Preprocessor
from tacshade_edge.sensor.profiles import PAPER_WITHOUT_EQ_11, PROFILES, Profile
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, F64, U8, Bool, Calibration, Frame
from tools.testbed.simulator.families import working_sensors

STRIDES_PX = (1, 2, 4)
TOP_MM, HALF_UNIT = 3.0, 2.0**-24
DEPTHS_MM = (1.2, 3.0)
PARTS = ("check", "grey", "gate", "denoise", "depth", "cloud")


def presses(sensor: object) -> Iterator[tuple[U8, KnownTruth]]:
    """The paper's objects, pressed into a skin of any size."""
    model = sensor.model  # type: ignore[attr-defined]
    scale = model.skin_radius_mm / 20
    for k, name in enumerate(PAPER_OBJECTS):
        for depth_mm in DEPTHS_MM:
            at = (1.5 * scale * (k - 2), -1.0 * scale)
            press = Press(OBJECTS[name](), *at, depth_mm * scale, 25.0 * k, scale)
            frame = sensor.frame((press,), 7 + k)  # type: ignore[attr-defined]
            yield to_grey(frame.image), KnownTruth.of(frame.truth())


def off_mm(g_hn: F32, inside: Bool) -> tuple[F64, F64]:
    """By cell of the disc: float32 against the published iteration, and that one against itself."""
    published = unit_height(g_hn.astype(np.float64), inside)
    found = np.where(inside, HybridIteration(g_hn.shape)(g_hn, inside)[0], 0).astype(np.float64)
    noise = 1 + HALF_UNIT * np.random.default_rng(0).uniform(-1, 1, g_hn.shape)
    rounded = unit_height(g_hn * noise, inside)
    own = found / max(found.max(), np.finfo(float).tiny)
    return (
        TOP_MM * np.abs(own - published)[inside],
        TOP_MM * np.abs(rounded - published)[inside],
    )


def stage_ms(
    calibration: Calibration, profile: Profile, image: U8, rounds: int
) -> list[Mapping[str, float]]:
    """Processor time of each stage in each round, after a first frame that allocates."""
    made = Reconstructor(calibration, profile)
    taken: list[Mapping[str, float]] = []
    for _ in range(rounds + 1):
        parts = Parts()
        made.step(Frame(0, 0, 0, image), parts)
        taken.append(parts.ms)
    return taken[1:]


def me_mm(calibration: Calibration, profile: Profile, image: U8, truth: KnownTruth) -> float:
    """Eq. 13; NaN if no contact is found."""
    points = Reconstructor(calibration, profile).step(Frame(0, 0, 0, image)).cloud.points_mm
    return score_cloud(points, truth.points_mm, 1.0).me_mm


def line(stride_px: int, sensors: Sequence[tuple[object, Calibration]], rounds: int) -> list[str]:
    """A stride's row of the table."""
    profile, plain = (
        replace(each, stride_px=stride_px) for each in (PROFILES["paper"], PAPER_WITHOUT_EQ_11)
    )
    times: list[Mapping[str, float]] = []
    errors: list[tuple[float, ...]] = []
    off: list[F64] = []
    own: list[F64] = []
    for sensor, calibration in sensors:
        preprocessor = Preprocessor(calibration, profile)
        mapper = GreyMapper(preprocessor)
        for image, truth in presses(sensor):
            made = with_own_ratio(calibration, truth.depth_max_mm)
            times += stage_ms(made, profile, image, rounds)
            errors.append(tuple(me_mm(made, each, image, truth) for each in (profile, plain)))
            maps = mapper.maps(preprocessor.preprocess(image))
            both = off_mm(finite_shape_grey(maps)[0], maps.inside)
            off.append(both[0])
            own.append(both[1])
    cells, own_cells = np.concatenate(off), np.concatenate(own)
    total = float(np.median([sum(each.values()) for each in times]))
    parts = [float(np.median([each.get(part, np.nan) for each in times])) for part in PARTS]
    shown = [f"{np.percentile(cells, 99.9):.5f}", f"{cells.max():.4f}", f"{own_cells.max():.4f}"]
    return [
        str(stride_px),
        f"{total:.1f}",
        *(f"{ms:.2f}" for ms in parts),
        *shown,
        *(f"{error:.2f}" for error in np.nanmean(errors, axis=0)),
    ]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="`paper` at strides of 1, 2 and 4 px.")
    parser.add_argument(
        "--sensors",
        type=working_sensors,
        default=working_sensors("default,5,21"),
        metavar="SEED,...",
    )
    parser.add_argument("--rounds", type=int, default=5)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    sensors = [(name.make(), calibrated(name, 8, 0).calibration) for name in args.sensors]
    lines = [line(stride_px, sensors, args.rounds) for stride_px in STRIDES_PX]
    header = ["stride px", "ms", *PARTS, "off 99.9 % mm", "off, most", "rounding, most", "ME mm"]
    header.append("ME without eq. 11")
    print(markdown(header, lines))


if __name__ == "__main__":
    main()
