"""Public sets of frames of real sensors, and what is known of each frame.

Their clones lie outside the tree; `real_frames.py` says how to fetch them.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.errors import ConfigError
from tacshade_edge.types import Disc

SENSOR = StatedSensor(
    skin_radius_mm=20.0, camera_distance_mm=14.0, visible_half_angle_deg=50.0, polarity="dark"
)
"""A TacTip as printed; its camera's distance is a guess that does not affect ranks."""
OTHER_LIGHT = "REF_lightson_pointingup"
PLATES = "data/cr_tactip/surface_3d/val_data"
TILTED = "tactile_data/ur5_tacpad_1/surface_zRxy_shear/train"
TILTED_CIRCLE = Disc(112, 150, 150)
PINS = "data/127/model_surface2d"
PIN_FRAMES = 100
"""Frames of `pins` that figures use, the first by number."""
TAP_MM = 5.0
"""The robot's tap at the stated position 0 of `pins`;
from there on, a greater position is deeper.
"""
NEARLY_FREE_MM = 0.117
"""Stated depth below which the plates of `tilted` hardly touch: 37 frames."""


@dataclass(frozen=True, slots=True)
class RealFrame:
    """A picture and what is known of it: whether nothing touched (None if unknown), and some
    columns of LABELS.csv, or `tilt_deg`, the size of a tilt about an unknown axis.
    """

    path: Path
    free: bool | None
    known: Mapping[str, float]


def raw_frames(clone: Path) -> list[RealFrame]:
    """Every whole picture, without the folder of another light;
    the labels are that project's own network's.
    """
    frames = []
    for table in sorted((clone / "data" / "tactip_images").glob("*/image_list.csv")):
        if table.parent.name == OTHER_LIGHT:
            continue
        for row in rows_of(table):
            free = row["contact"] == "False"
            known = {} if free else labels_of(row)
            # Images are numbered from 1 in the table and from 0 in their names.
            frames.append(
                RealFrame(
                    table.parent / f"raw_image{int(row['Image number']) - 1}.png", free, known
                )
            )
    return found(frames, clone, "data/tactip_images/*/image_list.csv")


def plate_frames(clone: Path) -> list[RealFrame]:
    """Every thresholded picture of `cr_tactip`'s validation set: none is free."""
    folder = clone / PLATES
    table = folder / "targets_images.csv"
    rows = rows_of(table) if table.exists() else []
    return found(
        [
            RealFrame(folder / "processed_images" / row["sensor_image"], False, labels_of(row))
            for row in rows
        ],
        clone,
        f"{PLATES}/targets_images.csv",
    )


def binary_frames(clone: Path) -> list[RealFrame]:
    """Every near-binary picture; which are free is unknown."""
    paths = sorted((clone / "dataset-image").glob("*/*/*.png"))
    return found([RealFrame(path, None, {}) for path in paths], clone, "dataset-image/*/*/*.png")


def flat_frames(clone: Path) -> list[RealFrame]:
    """Every picture of flat presses; the last number of a name is the stated depth,
    0 without one.
    """
    folder = "CNNDepthPrediction/DatasetReal/FlatR100V0"
    frames = []
    for path in sorted((clone / folder).glob("*.png")):
        depth_mm = float(path.stem.rpartition("_")[2])
        frames.append(RealFrame(path, not depth_mm, {"depth_mm": depth_mm} if depth_mm else {}))
    return found(frames, clone, f"{folder}/*.png")


def tilted_frames(clone: Path) -> list[RealFrame]:
    """Every raw picture of one sensor on tilted and sheared plates."""
    table = clone / TILTED / "targets.csv"
    rows = rows_of(table) if table.exists() else []
    frames = []
    for row in rows:
        known = labels_of(row)
        free = known["depth_mm"] < NEARLY_FREE_MM
        frames.append(RealFrame(table.parent / "sensor_images" / row["sensor_image"], free, known))
    frames.sort(key=lambda frame: frame.known["depth_mm"])
    return found(frames, clone, f"{TILTED}/targets.csv")


def all_pin_frames(clone: Path) -> list[RealFrame]:
    """The free picture of a sensor with 127 pins, and its taps of a tilted plane, by number."""
    table = clone / PINS / "targets.csv"
    pictures = clone / PINS / "frames_bw"
    rows = rows_of(table) if table.exists() else []
    frames = [
        RealFrame(
            pictures / row["image_name"],
            False,
            {"depth_mm": TAP_MM + float(row["pose_2"]), "tilt_deg": abs(float(row["pose_6"]))},
        )
        for row in rows
    ]
    free = [RealFrame(pictures / "init_0.png", True, {})] if rows else []
    return found([*free, *frames], clone, f"{PINS}/targets.csv")


def pin_frames(clone: Path) -> list[RealFrame]:
    """The free picture and the first hundred of `all_pin_frames`."""
    return all_pin_frames(clone)[: 1 + PIN_FRAMES]


SETS: dict[str, Callable[[Path], list[RealFrame]]] = {
    "raw": raw_frames,
    "binary": binary_frames,
    "plates": plate_frames,
    "flat": flat_frames,
    "tilted": tilted_frames,
    "pins": pin_frames,
}
SENSORS = {"tilted": replace(SENSOR, visible_circle=TILTED_CIRCLE)}


def found(frames: list[RealFrame], clone: Path, expected: str) -> list[RealFrame]:
    """Return `frames`. Raises ConfigError if there are none."""
    if not frames:
        raise ConfigError(f"{clone}: found no frame, expected a clone with {expected}")
    return frames


def rows_of(table: Path) -> list[dict[str, str]]:
    """A table's rows, without the spaces around its words."""
    with table.open(encoding="utf-8", newline="") as stream:
        lines = [[cell.strip() for cell in row] for row in csv.reader(stream) if row]
    return [dict(zip(lines[0], line, strict=False)) for line in lines[1:]]


def labels_of(row: Mapping[str, str]) -> dict[str, float]:
    """Both projects' columns as those of LABELS.csv."""
    names = {
        "pose_z": "depth_mm",
        "pose_Rx": "tilt_x_deg",
        "pose_Ry": "tilt_y_deg",
        "shear_x": "shear_x_mm",
        "shear_y": "shear_y_mm",
    }
    return {ours: float(row[theirs]) for theirs, ours in names.items()}


def thinned(frames: list[RealFrame], count: int) -> list[RealFrame]:
    """At most `count` frames, evenly spread."""
    if len(frames) <= count:
        return frames
    return [frames[k * len(frames) // count] for k in range(count)]
