"""Read a user's own images with the ground truth next to them, and score the reconstruction."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.core.geometry.back_projection import skin_points
from tacshade_edge.core.geometry.disc import Grid, disc_rays
from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.npz import read_arrays
from tacshade_edge.studies.evaluate.score import KnownTruth, Label, Row, between_pixels, score
from tacshade_edge.studies.evaluate.sensors import reconstructor
from tacshade_edge.studies.evaluate.work import Case, Timing
from tacshade_edge.studies.parallel import Report
from tacshade_edge.types import Calibration, Frame, Geometry

EXPECTED = "points_mm, or height_mm and contact"
_BYTES_MAX = 256 << 20


def read_truth(path: Path, image_size_px: tuple[int, int], geometry: Geometry) -> tuple[KnownTruth, str]:
    """Read an image's ground truth, the keys that ``tacshade-edge simulate`` writes, and the object's name.

    These are ``points_mm`` (N, 3), or ``height_mm`` and ``contact`` (rows, cols), or all three. By default, ``row0``,
    ``col0``, ``step_px`` are 0, 0, 1, ``depth_max_mm`` is the greatest height, and the name is the file's. The geometry
    converts heights to points if none are given. Raises DecodeError if the file is missing, damaged, or has other keys
    or another size than the image (height, width).
    """
    content = _content(path)
    contact = height = None
    if "contact" in content:
        contact = _array(path, content, "contact", 2).astype(bool)
    if "height_mm" in content:
        height = _array(path, content, "height_mm", 2)
    row0, col0 = (_number(path, content, key, 0.0) for key in ("row0", "col0"))
    step = _number(path, content, "step_px", 1.0)
    for name, grid in (("contact", contact), ("height_mm", height)):
        if grid is not None:
            _check_covers(path, name, grid.shape, (row0, col0, step), image_size_px)
    if "points_mm" in content:
        points = _array(path, content, "points_mm", 2)
        if points.shape[1] != 3 or not np.isfinite(points).all():
            raise DecodeError(
                f"{path}: points_mm: found numbers of shape {points.shape}, expected finite numbers of shape (N, 3)"
            )
    elif height is not None and contact is not None:
        if not np.isfinite(height[contact]).all():
            raise DecodeError(f"{path}: height_mm: found NaN inside the contact, expected a height in mm")
        rays = disc_rays(Grid(height.shape[0], height.shape[1], row0, col0, step), geometry)
        points = between_pixels(skin_points(height.astype(np.float32), rays, geometry)[contact], contact)
    else:
        raise DecodeError(f"{path}: found the keys {', '.join(sorted(content)) or 'none'}; expected {EXPECTED}")
    top = geometry.skin_radius_mm - float(np.linalg.norm(points, axis=1).min()) if len(points) else 0.0
    if height is not None:
        top = float(np.nanmax(height, initial=0.0))
    depth_max = _number(path, content, "depth_max_mm", top)
    if len(points) and not depth_max > 0:
        raise DecodeError(
            f"{path}: found a contact whose greatest depth is {depth_max:.3g} mm, expected more than 0 mm"
        )
    name = str(content["object"]) if "object" in content else path.stem
    return KnownTruth(points.astype(np.float32), depth_max, contact, row0, col0, step), name


def _content(path: Path) -> dict[str, Any]:
    try:
        return read_arrays(path, _BYTES_MAX, kinds="biufU")
    except FileNotFoundError:
        raise DecodeError(f"{path}: found no such file, expected the image's ground truth: {EXPECTED}") from None
    except OSError as error:
        raise DecodeError(f"{path}: {error.strerror or error}, expected {EXPECTED}") from None
    except DecodeError:
        raise DecodeError(f"{path}: the file is damaged or not an .npz file; expected {EXPECTED}") from None


def _array(path: Path, content: dict[str, Any], key: str, dimensions: int) -> Any:
    array = content[key]
    if array.ndim != dimensions or array.dtype.kind not in "bfiu":
        raise DecodeError(
            f"{path}: {key}: found {array.dtype} values of shape {array.shape}, "
            f"expected numbers in {dimensions} dimensions"
        )
    return array


def _number(path: Path, content: dict[str, Any], key: str, default: float) -> float:
    if key not in content:
        return default
    value = content[key]
    if value.size != 1 or value.dtype.kind not in "fiu" or not math.isfinite(value.item()):
        raise DecodeError(f"{path}: {key}: found {value!r}, expected one number")
    number = float(value.item())
    if key == "step_px" and number <= 0:
        raise DecodeError(f"{path}: step_px: found {number}, expected a number above 0")
    return number


def _check_covers(
    path: Path,
    key: str,
    shape: tuple[int, ...],
    grid: tuple[float, float, float],
    image_size_px: tuple[int, int],
) -> None:
    """Raise DecodeError for a map that leaves a margin of a step or more of the image uncovered."""
    step = grid[2]
    for origin, count, size in zip(grid[:2], shape, image_size_px, strict=True):
        if not -step < origin < step or not -step < size - 1 - (origin + step * (count - 1)) < step:
            raise DecodeError(
                f"{path}: {key}: found {shape[1]}x{shape[0]} cells of {step:g} px, expected cells that cover the "
                f"image's {image_size_px[1]}x{image_size_px[0]} px"
            )


def read_images(
    calibration: Calibration, sensor: str, images: Sequence[Path], report: Report, mistake: Callable[[str], None]
) -> Iterator[Case]:
    """Yield images with their ground truth; report an unusable one to `mistake` in one line and continue."""
    size = (calibration.image_height_px, calibration.image_width_px)
    for k, path in enumerate(images):
        report("images", k, len(images))
        try:
            image = read_image(path)
            if image.shape[:2] != size:
                found, expected = (f"{width}x{height} px" for height, width in (image.shape[:2], size))
                raise DecodeError(f"{path}: found {found}, expected {expected}, the size of the calibration's images")
            truth, name = read_truth(path.with_suffix(".npz"), size, calibration.geometry)
        except DecodeError as error:
            mistake(str(error))
            continue
        yield Case(Label(sensor, name if len(truth.points_mm) else "none", path.name), truth, image)
    report("images", len(images), len(images))


def evaluate_images(
    calibration: Calibration, profiles: Sequence[str], cases: Iterable[Case]
) -> tuple[list[Row], dict[str, Timing]]:
    """Score images one after another in this process and time every step."""
    made = {profile: reconstructor(calibration, profile) for profile in profiles}
    taken: dict[str, list[float]] = {profile: [] for profile in profiles}
    rows = []
    for case in cases:
        frame = Frame(0, 0, 0, case.image)
        for profile, each in made.items():
            if not taken[profile]:
                each.step(frame)  # the first step imports and allocates
            start = time.perf_counter_ns()
            result = each.step(frame)
            taken[profile].append((time.perf_counter_ns() - start) / 1e6)
            rows.append(score(case.label, case.truth, result))
    timings = {p: Timing(float(np.median(ms)), len(ms)) for p, ms in taken.items() if ms}
    return rows, timings
