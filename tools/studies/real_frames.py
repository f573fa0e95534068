#!/usr/bin/env python3
"""Frames of real sensors: what is accepted, refused, felt in the air, lost, and follows labels.

::

    git clone https://github.com/BioMorphic-Intelligence-Lab/aerial_tactile_servoing
        out/real/aerial_tactile_servoing
    git clone https://github.com/marselap/tactip-cnn-bayes out/real/tactip-cnn-bayes
    git clone https://github.com/dexterousrobot/tactile_data_shear out/real/tactile_data_shear
    git clone https://github.com/cavallimarko/TacTipFlexSim out/real/TacTipFlexSim
    git clone https://github.com/robot-dexterity/tactile-manibot out/real/tactile-manibot
    git clone https://github.com/Neo-manchester/Tac-VGNN out/real/Tac-VGNN
    .venv/bin/python -m tools.studies.real_frames raw out/real/aerial_tactile_servoing

The sets have no licence, or the GPL, but for the last (Apache-2.0): they stay outside the tree.
`raw` are whole pictures of a camera with an LED ring, `binary` near-binary ones with few pins,
`plates` thresholded ones of plates that a robot tilted and sheared (of that set `cr_tactip` alone),
`flat` flat presses of stated depth, `tilted` raw pictures of tilted and sheared plates whose rim
the frame cuts, `pins` thresholded ones of 127 pins that tap a tilted plane. A network is overruled
where it finds `LEAST_MM` or more and the answer is another.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.studies.evaluate.labelled import FoundRow, agreements, found_row, spearman
from tacshade_edge.lab.studies.evaluate.work import reconstructor
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import Calibration, Frame
from tools.studies.judges import LEAST_MM, MARGINS, Margins, Seen, seen
from tools.studies.real_references import report_each
from tools.studies.real_sets import SENSOR, SENSORS, SETS, RealFrame, thinned

PROFILES = ("fast", "balanced", "accurate")
REFERENCES_EACH = 2
"""Number of free frames at a folder's start that are tried as references."""
PUBLISHED = (
    "0.106 mm of depth, 0.32° of tilt, 0.78 mm of shear, 1.48° of twist (mean absolute, "
    "4002 labels)"
)


def reference_candidates(frames: Sequence[RealFrame]) -> list[Path]:
    """The first free frames of each folder; where none is free the least pressed one,
    or the one most like the mean.
    """
    if any(frame.free for frame in frames):
        folders: dict[Path, list[Path]] = {}
        for frame in frames:
            if frame.free:
                folders.setdefault(frame.path.parent, []).append(frame.path)
        return [path for paths in folders.values() for path in paths[:REFERENCES_EACH]]
    if any(frame.known for frame in frames):
        return [min(frames, key=lambda frame: frame.known["depth_mm"]).path]
    some = [frame.path for frame in thinned(list(frames), 100)]
    pictures = np.stack([to_grey(read_image(path)) for path in some]).astype(np.float32)
    return [some[int(np.abs(pictures - pictures.mean(axis=0)).mean(axis=(1, 2)).argmin())]]


def calibrated_from(sensor: StatedSensor, path: Path) -> tuple[Calibration | None, str]:
    """A calibration without presses, or why there is none."""
    try:
        return calibrate(sensor, [read_image(path)]).calibration, ""
    except ConfigError as error:
        return None, str(error)


def forced(sensor: StatedSensor, paths: Sequence[Path]) -> Calibration:
    """From the first that works when it may be loaded.

    Raises ConfigError with the last one's reason.
    """
    for path in paths[:-1]:
        try:
            return calibrate(sensor, [read_image(path)], allow_loaded_reference=True).calibration
        except ConfigError:
            continue
    return calibrate(sensor, [read_image(paths[-1])], allow_loaded_reference=True).calibration


def counted(reasons: Iterable[str]) -> str:
    """Each reason with its count, the most frequent first."""
    return ", ".join(f"{reason} {count}" for reason, count in Counter(reasons).most_common()) or "-"


def summary(
    frames: Sequence[RealFrame], rows: Sequence[FoundRow], all_seen: Sequence[Seen]
) -> tuple[str, ...]:
    """One profile's counts: refused, why, false contacts on free frames, presses refused or empty,
    those of more than `LEAST_MM`, and networks overruled.
    """
    refused = [row.refused for row in rows if row.refused]
    free = [row for frame, row in zip(frames, rows, strict=True) if frame.free]
    pressed = [row for frame, row in zip(frames, rows, strict=True) if frame.free is False]
    deep = [
        row
        for frame, row in zip(frames, rows, strict=True)
        if frame.known.get("depth_mm", 0) > LEAST_MM
    ]
    return (
        rows[0].profile,
        f"{len(refused)} of {len(rows)}",
        counted(refused),
        f"{sum(r.contact and not r.refused for r in free)} of {len(free)}" if free else "-",
        f"{sum(bool(r.refused) or not r.contact for r in pressed)} of {len(pressed)}"
        if pressed
        else "-",
        f"{sum(bool(r.refused) or not r.contact for r in deep)} of {len(deep)}" if deep else "-",
        f"{sum(one.overruled for one in all_seen)} of {len(all_seen)}",
    )


def tilt_of(row: FoundRow) -> float:
    """Angle between the found normal and the sensor's axis, degrees."""
    x, y = (math.tan(math.radians(angle)) for angle in (row.tilt_y_deg, row.tilt_x_deg))
    return math.degrees(math.atan(math.hypot(x, y)))


def followed(frames: Sequence[RealFrame], rows: Sequence[FoundRow]) -> list[tuple[str, ...]]:
    """One profile's ranks and errors; of shear also before any map."""
    profile, known = rows[0].profile, [frame.known for frame in frames]
    table: list[tuple[str, ...]] = [
        (profile, a.quantity, str(a.frames), f"{a.rank_correlation:.2f}", f"{a.error:.2f}")
        for a in agreements(rows, known)
    ]
    depths = [
        (row.depth_mm, labels["depth_mm"])
        for row, labels in zip(rows, known, strict=True)
        if not row.refused and row.contact and "depth_mm" in labels
    ]
    if depths:
        off_mm = np.subtract(*np.transpose(depths))
        error_mm = np.abs(off_mm - np.median(off_mm)).mean()
        table.append((profile, "depth, one offset", str(len(depths)), "-", f"{error_mm:.2f}"))
    off_deg = [
        abs(tilt_of(row) - labels["tilt_deg"])
        for row, labels in zip(rows, known, strict=True)
        if not row.refused and row.contact and "tilt_deg" in labels
    ]
    if off_deg:
        table.append((profile, "tilt, no map", str(len(off_deg)), "-", f"{np.mean(off_deg):.2f}"))
    pairs = [
        ((row.shear_x_mm, row.shear_y_mm), (labels["shear_x_mm"], labels["shear_y_mm"]))
        for row, labels in zip(rows, known, strict=True)
        if not row.refused
        and "shear_x_mm" in labels
        and np.isfinite((row.shear_x_mm, row.shear_y_mm)).all()
    ]
    if len(pairs) > 3:
        ours, theirs = np.array(pairs).transpose(1, 2, 0)
        ranks = [spearman(a, b) for a, b in zip(ours, theirs, strict=True)]
        table.append((profile, "shear, no map", str(len(pairs)), f"{np.mean(ranks):.2f}", "-"))
    return table


def fitted(calibration: Calibration) -> Calibration:
    """The calibration with the networks fitted to its reference alone; print what was found."""
    from tacshade_edge.lab.fitting.fit import fit  # PyTorch is needed only here

    made = fit(calibration, (), lambda _: None)
    print("\n".join((*made.found, *(network.line for network in made.networks), "")))
    return made.calibration


def as_made(calibration: Calibration) -> Calibration:
    """The calibration with the shipped networks."""
    return calibration


def report(name: str, frames: list[RealFrame], profiles: Sequence[str], fits: bool) -> None:
    """Measure a set and print its tables."""
    candidates, sensor = reference_candidates(frames), SENSORS.get(name, SENSOR)
    tried = [calibrated_from(sensor, path) for path in candidates]
    accepted = [calibration for calibration, _ in tried if calibration is not None]
    free = (
        "free frames"
        if any(frame.free for frame in frames)
        else "frames (none is known to be free)"
    )
    print(f"References: `calibrate` accepts {len(accepted)} of {len(candidates)} {free}.")
    if any(reason for _, reason in tried):
        print(f"Refused: {counted(reason.partition(':')[0] for _, reason in tried if reason)}.")
    calibration = accepted[0] if accepted else forced(sensor, candidates)
    if not accepted:
        print("The first is taken all the same, as by `--allow-loaded-reference`.")
    disc = calibration.geometry.disc
    print(
        f"Circle: row {disc.row_c:.0f}, column {disc.col_c:.0f}, radius {disc.radius_px:.0f} px.\n"
    )
    calibration = fitted(calibration) if fits else calibration
    made = {profile: reconstructor(calibration, profile) for profile in profiles}
    rows: dict[str, list[FoundRow]] = {profile: [] for profile in profiles}
    all_seen: dict[str, list[Seen]] = {profile: [] for profile in profiles}
    margins = Margins()
    for frame in frames:
        image = read_image(frame.path)
        for profile, one in made.items():
            result = one.step(Frame(0, 0, 0, image))
            rows[profile].append(found_row(frame.path.name, result))
            all_seen[profile].append(seen(one, image, result))
            margins.add(one.measured(image), usual=result.reason is None)
    columns = (
        "profile",
        "refused",
        "why",
        "contacts on free frames",
        "presses refused or empty",
        f"of more than {LEAST_MM:g} mm",
        "network overruled",
    )
    print(
        markdown(
            columns, [summary(frames, some, all_seen[profile]) for profile, some in rows.items()]
        )
    )
    if near := margins.rows(near_only=True):
        print("\nFigures that come within half of a judge's limit\n\n" + markdown(MARGINS, near))
    figures = [line for some in rows.values() for line in followed(frames, some)]
    if figures:
        print(
            "\n"
            + markdown(("profile", "quantity", "frames", "rank correlation", "mean error"), figures)
        )
    if name == "plates":
        print(f"\nPublished networks, trained on this robot's own labels: {PUBLISHED}.")


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("set", choices=SETS)
    parser.add_argument("clone", type=Path)
    parser.add_argument("--profile", nargs="+", choices=PROFILES, default=PROFILES)
    parser.add_argument(
        "--frames", type=int, default=500, metavar="N", help="of the set, evenly (500)"
    )
    parser.add_argument(
        "--references",
        type=int,
        metavar="N",
        help="make each of N free frames, evenly spread, the only reference in turn",
    )
    parser.add_argument("--fit", action="store_true", help="the networks to the reference")
    args = parser.parse_args()
    cv2.setNumThreads(1)
    try:
        frames = SETS[args.set](args.clone)
        if args.references:
            made = fitted if args.fit else as_made
            sensor = SENSORS.get(args.set, SENSOR)
            counts = args.references, args.frames
            report_each(frames, sensor, args.profile, counts, made)
        else:
            report(args.set, thinned(frames, args.frames), args.profile, args.fit)
    except (ConfigError, DecodeError) as error:
        print(f"real_frames.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
