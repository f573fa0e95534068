#!/usr/bin/env python3
"""How far off the shear of a contact is: by the networks, by dense optical flow, and by tracked points.

::

    .venv/bin/python -m tools.studies.shear [--sensors default,5,other:31] [--presses 12]

Objects are pressed 3 mm deep and dragged up to 3 mm, in `STEPS` frames. Flow and points turn into mm by the true
depth. Flow (Farneback 2003, on the grey picture) compares the last frame with the reference, as one image
must; once it begins at the true shear: what is left then is not for want of a good guess. Points (Shi and Tomasi
1994, Lucas and Kanade 1981) are tracked through all frames, checked backwards.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import replace
from functools import partial
from itertools import pairwise

import cv2
import numpy as np

from tacshade_edge.core.geometry.back_projection import skin_planes
from tacshade_edge.core.geometry.disc import DiscRays, disc_mask
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.simulator.objects import OBJECTS
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedFrame
from tacshade_edge.studies.evaluate.sensors import PressedSensor, SensorName, calibrated, reconstructor
from tacshade_edge.studies.tables import markdown
from tacshade_edge.types import F32, F64, U8, Bool, Frame, Geometry
from tools.testbed.simulator.families import sensor_name

STEPS, DEPTH_MM, DRAGS_MM = 16, 3.0, (0.0, 1.0, 2.0, 3.0)
BACKWARDS_PX = 0.5
"""Greatest error of a point tracked forwards and back before it is dropped, px."""


def xy_mm(geometry: Geometry, rows: F32, cols: F32, height_mm: F32) -> F32:
    """Positions (x, y) in mm of the skin that pixels see, (..., 2)."""
    u, v = cols - geometry.disc.col_c, rows - geometry.disc.row_c
    by = geometry.f_px or 1 / geometry.mm_per_px
    rays = DiscRays(np.ones(rows.shape, bool), (u / by).astype(np.float32), (v / by).astype(np.float32))
    return np.moveaxis(skin_planes(height_mm.astype(np.float32), rays, geometry)[:2], 0, -1)


def of_flow(geometry: Geometry, reference: U8, grey: U8, height_mm: F32, contact: Bool, begun: F32 | None) -> F32:
    """A contact's mean shear by dense flow from the frame back to the reference."""
    flags = 0 if begun is None else cv2.OPTFLOW_USE_INITIAL_FLOW
    levels = 4 if begun is None else 1
    flow = cv2.calcOpticalFlowFarneback(grey, reference, begun, 0.5, levels, 31, 5, 7, 1.5, flags)
    rows, cols = (axis.astype(np.float32) for axis in np.nonzero(contact))
    back = flow[contact]
    now = xy_mm(geometry, rows, cols, height_mm[contact])
    before = xy_mm(geometry, rows + back[:, 1], cols + back[:, 0], np.zeros_like(rows))
    return np.nanmean(now - before, axis=0)


def true_flow(geometry: Geometry, frame: SimulatedFrame, height_mm: F32, contact: Bool) -> F32:
    """Pixels back to the reference, (H, W, 2), by the truth where the skin touches; its mean elsewhere."""
    rows, cols = np.nonzero(contact)
    seen = xy_mm(geometry, rows.astype(np.float32), cols.astype(np.float32), height_mm[contact])
    before: F64 = seen - frame.shear_mm(rows.astype(float), cols.astype(float))
    z = np.sqrt(geometry.skin_radius_mm**2 - (before**2).sum(axis=1))
    d = geometry.camera_distance_mm
    px = before / geometry.mm_per_px if d is None else before * (geometry.f_px / (z + d))[:, None]
    flow = np.zeros((*contact.shape, 2), np.float32)
    moved = np.stack((px[:, 0] + geometry.disc.col_c - cols, px[:, 1] + geometry.disc.row_c - rows), axis=1)
    flow[...] = moved.mean(axis=0)
    flow[contact] = moved
    return flow


def tracked(greys: list[U8], mask: U8) -> tuple[F32, F32]:
    """Points of the first frame that could be followed, and where they are in the last; column and row, (N, 2) each."""
    first = cv2.goodFeaturesToTrack(greys[0], 2000, 0.02, 4, mask=mask)
    now, alive = first, np.ones(len(first), bool)
    follow = partial(cv2.calcOpticalFlowPyrLK, nextPts=None, winSize=(15, 15), maxLevel=2)
    for before, after in pairwise(greys):
        new, found, _ = follow(before, after, now)
        back, returned, _ = follow(after, before, new)
        near = np.linalg.norm((back - now)[:, 0], axis=1) < BACKWARDS_PX
        alive &= near & (found[:, 0] > 0) & (returned[:, 0] > 0)
        now = new
    return first[alive, 0], now[alive, 0]


def of_points(geometry: Geometry, greys: list[U8], height_mm: F32, contact: Bool) -> F32:
    """Mean shear of the points that end in a contact; NaN where fewer than three do."""
    height, width = contact.shape
    first, last = tracked(greys, disc_mask(height, width, geometry.disc).astype(np.uint8))
    at = np.rint(last).astype(int)
    ends: Bool = np.asarray((at >= 0).all(axis=1) & (at < (width, height)).all(axis=1))
    ends[ends] = contact[at[ends, 1], at[ends, 0]]
    if ends.sum() < 3:
        return np.full(2, np.nan, np.float32)
    h = height_mm[at[ends, 1], at[ends, 0]]
    now = xy_mm(geometry, last[ends, 1], last[ends, 0], h)
    return np.nanmean(now - xy_mm(geometry, first[ends, 1], first[ends, 0], np.zeros_like(h)), axis=0)


def errors(name: SensorName, count: int) -> list[tuple[float, list[float]]]:
    """Each press's drag and the error of each method, mm."""
    sensor: PressedSensor = name.make()
    calibration = calibrated(name, 8, 40).calibration
    geometry, rows = calibration.geometry, []
    made = {profile: reconstructor(calibration, profile) for profile in PROFILES if profile != "paper"}
    reference = to_grey(sensor.frame((), 1).image)
    rng = np.random.default_rng(0)
    for k in range(count):
        drag = DRAGS_MM[k % len(DRAGS_MM)]
        shape = OBJECTS[list(OBJECTS)[int(rng.integers(len(OBJECTS)))]]()
        angle = float(rng.uniform(0, 2 * math.pi))
        x, y = (float(at) for at in rng.uniform(-4, 4, 2))
        press = Press(shape, x, y, DEPTH_MM, float(rng.uniform(0, 360)))
        greys = [reference]
        for step in range(1, STEPS + 1):
            deep, far = min(1.0, 3 * step / STEPS), drag * max(0.0, 1.5 * step / STEPS - 0.5)
            moved = replace(
                press, depth_mm=DEPTH_MM * deep, drag_x_mm=far * math.cos(angle), drag_y_mm=far * math.sin(angle)
            )
            frame = sensor.frame((moved,), 100 * k + step)
            greys.append(to_grey(frame.image))
        truth = frame.truth()
        at = np.nonzero(truth.contact)
        true = frame.shear_mm(at[0].astype(float), at[1].astype(float)).mean(axis=0)
        found = [each.step(Frame(0, 0, 0, frame.image)).shear_of_contact_mm for each in made.values()]
        depth = np.nan_to_num(truth.height_mm).astype(np.float32)
        ways = [np.array(one if one else (np.nan, np.nan)) for one in found]
        ways.append(of_flow(geometry, reference, greys[-1], depth, truth.contact, None))
        begun = true_flow(geometry, frame, depth, truth.contact)
        ways.append(of_flow(geometry, reference, greys[-1], depth, truth.contact, begun))
        ways.append(of_points(geometry, greys, depth, truth.contact))
        rows.append((drag, [float(np.linalg.norm(way - true)) for way in ways]))
    return rows


def main() -> None:
    """Compare the methods and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default="default,5,other:31")
    parser.add_argument("--presses", type=int, default=24, help="of each sensor")
    args = parser.parse_args()
    rows = [row for name in args.sensors.split(",") for row in errors(sensor_name(name), args.presses)]
    heads = [name for name in PROFILES if name != "paper"]
    lines = []
    for drag in DRAGS_MM:
        off = np.array([each for far, each in rows if far == drag])
        cells = [f"{np.nanmedian(way):.2f} ({int(np.isnan(way).sum())})" for way in off.T]
        lines.append([f"{drag:g} mm", str(len(off)), *cells])
    print("Median of how far off the shear of a contact is, mm (contacts that it tells nothing of)\n")
    print(markdown(["drag", "contacts", *heads, "flow", "flow begun at the truth", "tracked points"], lines))


if __name__ == "__main__":
    main()
