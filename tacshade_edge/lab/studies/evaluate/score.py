"""Score a reconstruction against its ground truth: eqs.
13 and 14 of the paper, the outline, the depth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.errors import DecodeError
from tacshade_edge.files.npz import numbers, read_arrays
from tacshade_edge.lab.simulator.truth import Truth
from tacshade_edge.quoting import shown
from tacshade_edge.reasons import text_of
from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, point_heights, skin_points
from tacshade_edge.types import F32, F64, Bool, Geometry, HeightMap, Reconstruction, frozen

NOTHING = np.zeros((0, 3), dtype=np.float32)
"""The points of an untouched skin."""


@dataclass(frozen=True, slots=True)
class CloudScore:
    """The agreement of a reconstructed cloud with the true one;
    for an empty cloud, SD is 0 and distances are NaN.
    """

    me_mm: float  # eq. 13, the mean distance from reconstructed points to the nearest true point
    sd: float  # eq. 14 with half the sum of both mean distances (unsquared), not clamped at 0
    sd_sum: float  # eq. 14 with the whole sum
    backward_mm: float  # the mean distance from true points to the nearest reconstructed point


def score_cloud(points_mm: F32, true_points_mm: F32, h_max_mm: float) -> CloudScore:
    """Compute ME and SD of a cloud (N, 3), given the true points (M, 3;
    M > 0) and the true maximum of h.
    """
    # Scoring is not on the path of the daemon.
    from scipy.spatial import cKDTree

    if not len(points_mm):
        # There is no distance to nothing; means of many frames put the true depth in its place.
        return CloudScore(math.nan, 0.0, 0.0, math.nan)
    # Eq. 13 looks one way only, from the found to the true points: what is missing costs nothing
    # there. Hence the way back, which eq. 14 contains too.
    forward = float(cKDTree(true_points_mm).query(points_mm)[0].mean())
    backward = float(cKDTree(points_mm).query(true_points_mm)[0].mean())
    return CloudScore(
        forward,
        # Eq. 14 leaves open whether its distance is the sum or the mean of both ways; both are
        # reported, unclamped, because a negative SD says how bad a cloud is.
        1 - (forward + backward) / 2 / h_max_mm,
        1 - (forward + backward) / h_max_mm,
        backward,
    )


def contact_iou(found: Bool, true: Bool) -> float:
    """Intersection over union of two contact maps; 1 when both are empty."""
    # Both empty agree.
    union = np.count_nonzero(found | true)
    return 1.0 if union == 0 else np.count_nonzero(found & true) / union


@frozen
class KnownTruth:
    """The ground truth of a frame: skin points in contact, the greatest h over the disc,
    and the contact if known.

    Cell (i, j) of `contact` is pixel (row0 + i·step_px, col0 + j·step_px).
    """

    points_mm: F32  # (N, 3) in the sensor frame; N = 0 if nothing touches
    depth_max_mm: float
    contact: Bool | None
    row0: float = 0.0
    col0: float = 0.0
    step_px: float = 1.0
    height_mm: F32 | None = None  # (rows, cols) as `contact`
    shear_mm: F32 | None = None  # (rows, cols, 2), perhaps only of the contact

    @classmethod
    def of(cls, true: Truth) -> KnownTruth:
        """The ground truth of a simulated frame."""
        return cls(between_pixels(true.points_mm, true.contact), true.depth_max_mm, true.contact)

    def contact_on(self, height: HeightMap) -> Bool | None:
        """Sample `contact` at the cells of a height map (the nearest cell;
        False beyond its edge).
        """
        taken: Bool | None = self.sampled(self.contact, height, False)
        return taken

    def sampled(self, values: Any, height: HeightMap, beyond: float = math.nan) -> Any:
        """Sample one of the maps at the cells of a height map (the nearest cell);
        None if it is not known.
        """
        if values is None:
            return None
        at, inside = [], []
        for origin, count, mine, size in zip(
            (height.row0, height.col0),
            height.contact.shape,
            (self.row0, self.col0),
            values.shape[:2],
            strict=True,
        ):
            index = np.rint(
                (origin + height.step_px * np.arange(count) - mine) / self.step_px
            ).astype(int)
            at.append(np.clip(index, 0, size - 1))
            inside.append((index >= 0) & (index < size))
        taken = values[np.ix_(*at)]
        # Clipped indices repeat the border, which is not known there.
        taken[~(inside[0][:, None] & inside[1][None, :])] = beyond
        return taken

    def halved(self) -> KnownTruth:
        """The same ground truth for an image of half the size."""
        # Pixel centres: the middle of the first two pixels becomes pixel 0.
        row0, col0 = (self.row0 - 0.5) / 2, (self.col0 - 0.5) / 2
        return replace(self, row0=row0, col0=col0, step_px=self.step_px / 2)


def between_pixels(points_mm: F32, contact: Bool) -> F32:
    """Add the midpoints between neighbouring pixels' points,
    which are in the order of the pixels of `contact`.

    Without them, a found point between pixels would have an error of up to half a pixel. Across a
    steep step, over three times the usual distance, no midpoint is added. The given points come
    first.
    """
    at = np.full((*contact.shape, 3), np.nan, np.float32)
    at[contact] = points_mm
    pairs = [
        (at[:, :-1], at[:, 1:]),
        (at[:-1], at[1:]),
        (at[:-1, :-1], at[1:, 1:]),
        (at[1:, :-1], at[:-1, 1:]),
    ]
    apart = [np.linalg.norm(one - other, axis=-1) for one, other in pairs]
    beside = apart[0][np.isfinite(apart[0])]
    if not beside.size:
        return points_mm
    # Farther apart is a step, such as the wall of a cube, where the skin has no points between.
    near = 3 * np.median(beside)
    middles = [
        ((one + other) / 2)[far < near] for (one, other), far in zip(pairs, apart, strict=True)
    ]
    return np.concatenate((points_mm, *middles)).astype(np.float32)


@dataclass(frozen=True, slots=True)
class Label:
    """The columns of a row that identify its frame;
    `object` is ``none`` for a frame without contact.
    """

    sensor: str
    object: str
    image: str = (
        ""  # the user's image; for a simulated frame without contact, the change made to it
    )
    depth_mm: float = math.nan  # the stated press
    x_mm: float = math.nan
    y_mm: float = math.nan
    rotation_deg: float = math.nan


@dataclass(frozen=True, slots=True)
class Row:
    """The scores of one profile on one frame; each attribute is a column of evaluation.csv,
    empty if NaN.

    Without true contact, errors are NaN; where the result has no contact, ME and the backward
    distance are, and where it is `touched` everything about depth.
    """

    profile: str
    sensor: str
    object: str
    image: str
    depth_mm: float
    x_mm: float
    y_mm: float
    rotation_deg: float
    valid: bool
    contact: bool
    saturated: bool
    true_depth_mm: float
    found_depth_mm: float
    depth_error_pct: float
    me_mm: float
    sd_pct: float
    sd_sum_pct: float
    backward_mm: float
    iou: float
    points: int
    true_points: int
    objects: int
    repaired_px: int
    degraded: str  # why the reconstruction is invalid or degraded
    touched: bool  # something touches, but its depth is unknown


def score(label: Label, truth: KnownTruth, result: Reconstruction) -> Row:
    """Compare a reconstruction with its frame's ground truth."""
    pressed, nan = len(truth.points_mm) > 0 and truth.depth_max_mm > 0, math.nan
    cloud = (
        score_cloud(result.cloud.points_mm, truth.points_mm, truth.depth_max_mm)
        if pressed
        else None
    )
    contact = truth.contact_on(result.height)
    found_mm = nan if result.touched else result.depth_max_mm
    return Row(
        profile=result.profile,
        **asdict(label),
        valid=result.valid,
        contact=result.contact,
        saturated=result.saturated,
        true_depth_mm=truth.depth_max_mm,
        found_depth_mm=found_mm,
        depth_error_pct=100 * (found_mm / truth.depth_max_mm - 1) if pressed else nan,
        me_mm=cloud.me_mm if cloud else nan,
        sd_pct=100 * cloud.sd if cloud else nan,
        sd_sum_pct=100 * cloud.sd_sum if cloud else nan,
        backward_mm=cloud.backward_mm if cloud else nan,
        iou=contact_iou(result.height.contact, contact) if pressed and contact is not None else nan,
        points=len(result.cloud.points_mm),
        true_points=len(truth.points_mm),
        objects=len(result.objects),
        repaired_px=result.repaired_px,
        degraded=text_of(result.reason or result.degraded),
        touched=result.touched,
    )


EXPECTED = "points_mm, or height_mm and contact"
_BYTES_MAX = 256 << 20
# Less is no contact; a part of the greatest that a skin can have, as a file may be in m.
_DEPTH_MIN_MM, _DEPTH_PART_MAX = (
    0.02,
    0.8,
)


def read_truth(
    path: Path, image_size_px: tuple[int, int], geometry: Geometry
) -> tuple[KnownTruth, str]:
    """Read an image's ground truth, the keys that ``tacshade-edge simulate`` writes, and the
    object's name: ``points_mm`` (N, 3), or ``height_mm`` and ``contact`` (rows, cols), or all
    (docs/reference/calibration-checks.md).

    Raises DecodeError if the file is missing, damaged,
    or has other keys or another size than the image (height, width).
    """
    content = _content(path)
    try:
        return _truth(content, image_size_px, geometry), shown(content.get("object", path.stem), 60)
    except DecodeError as error:
        raise DecodeError(f"{path}: {error}") from None


def _truth(
    content: Mapping[str, Any], image_size_px: tuple[int, int], geometry: Geometry
) -> KnownTruth:
    contact = numbers(content, "contact", 2).astype(bool) if "contact" in content else None
    height = numbers(content, "height_mm", 2, nan=True) if "height_mm" in content else None
    row0, col0, step = (
        _number(content, key, default)
        for key, default in (("row0", 0), ("col0", 0), ("step_px", 1))
    )
    if step <= 0:
        raise DecodeError(f"step_px: found {step}, expected a number above 0")
    for name, grid in (("contact", contact), ("height_mm", height)):
        if grid is not None:
            _check_covers(name, grid.shape, (row0, col0, step), image_size_px)
    if "points_mm" in content:
        points = numbers(content, "points_mm", 2)
        if points.shape[1] != 3:
            raise DecodeError(
                f"points_mm: found numbers of shape {points.shape}, expected the shape (N, 3)"
            )
    elif height is not None and contact is not None:
        if height.shape != contact.shape or not np.isfinite(height[contact]).all():
            raise DecodeError(
                "height_mm: found NaN inside the contact or other cells, expected a height in mm"
            )
        rays = disc_rays(Grid(height.shape[0], height.shape[1], row0, col0, step), geometry)
        points = between_pixels(
            skin_points(height.astype(np.float32), rays, geometry)[contact], contact
        )
    else:
        raise DecodeError(
            f"found the keys {shown(', '.join(sorted(content)) or 'none')}; expected {EXPECTED}"
        )
    depth_max = _depth_max(content, height, points, geometry)
    shear = numbers(content, "shear_mm", 3, nan=True) if "shear_mm" in content else None
    if shear is not None:
        _check_covers("shear_mm", shear.shape[:2], (row0, col0, step), image_size_px)
        if shear.shape[2] != 2:
            raise DecodeError(
                f"shear_mm: found numbers of shape {shear.shape}, expected the shape (rows, cols, "
                "2)"
            )
    return KnownTruth(
        points.astype(np.float32), depth_max, contact, row0, col0, step, height, shear
    )


def _depth_max(
    content: Mapping[str, Any], height: F64 | None, points: F64, geometry: Geometry
) -> float:
    """The greatest h over the disc.

    Raises DecodeError if it, or that of the points in contact, cannot be.
    """
    # Without a map, the deepest point in contact is the depth: beside the object, the skirt is
    # never deeper.
    deepest = float(point_heights(points, geometry).max()) if len(points) else 0.0
    depth_max = _number(
        content,
        "depth_max_mm",
        deepest if height is None else float(np.nanmax(height, initial=0.0)),
    )
    # Catches metres and micrometres, which are the mistakes that files have.
    most = _DEPTH_PART_MAX * geometry.height_max_mm
    # Points as far outside the skin as they should be inside it are of another form of skin.
    known = ((depth_max, _DEPTH_MIN_MM), (deepest, -depth_max))
    wrong = [depth for depth, least in known if not least <= depth <= most]
    if len(points) and wrong:
        expected = f"expected a depth from {_DEPTH_MIN_MM:g} to {most:g} mm on this {geometry.skin}"
        raise DecodeError(f"found a contact whose greatest depth is {wrong[0]:.3g} mm, {expected}")
    return depth_max


def _content(path: Path) -> dict[str, Any]:
    try:
        return read_arrays(path, _BYTES_MAX, kinds="biufU")
    except FileNotFoundError:
        raise DecodeError(
            f"{path}: found no such file, expected the image's ground truth: {EXPECTED}"
        ) from None
    except OSError as error:
        raise DecodeError(f"{path}: {error.strerror or error}, expected {EXPECTED}") from None
    except DecodeError as error:
        raise DecodeError(f"{path}: {error}; expected {EXPECTED}") from None


def _number(content: Mapping[str, Any], key: str, default: float) -> float:
    return float(numbers(content, key, 0)) if key in content else default


def _check_covers(
    key: str,
    shape: tuple[int, ...],
    grid: tuple[float, float, float],
    image_size_px: tuple[int, int],
) -> None:
    """Raise DecodeError for a map that leaves a margin of a step or more of the image uncovered."""
    step = grid[2]
    # A map may be coarser than the picture, but must reach all of its edges: a smaller one is of
    # another picture.
    for origin, count, size in zip(grid[:2], shape, image_size_px, strict=True):
        if not -step < origin < step or not -step < size - 1 - (origin + step * (count - 1)) < step:
            raise DecodeError(
                f"{key}: found {shape[1]}x{shape[0]} cells of {step:g} px, expected cells that "
                f"cover the image's {image_size_px[1]}x{image_size_px[0]} px"
            )
