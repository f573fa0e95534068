"""POSES.csv: the pose of the robot's flange at each image, for ``tacshade-edge stitch``."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.regular_files import named_file
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.storage.tables.tables import number, read_columns

HEADER = ("image", "x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
ROWS_MAX = 100_000
_UNIT = 0.01


@dataclass(frozen=True, slots=True)
class PosedImage:
    """A line of the table.

    Attributes
    ----------
    where : str
        ``FILE:LINE``.
    path : Path
        The image's path.
    base_T_flange : Rigid
    """

    where: str
    path: Path
    base_T_flange: Rigid


def read_poses(path: Path) -> list[PosedImage]:
    """Read the table but not its images, whose paths are relative to it.

    Raises
    ------
    ConfigError
        ``FILE:LINE: column: found …, expected …``; or the table has no row.
    """
    table = read_columns(path, HEADER, (), "poses", rows_max=ROWS_MAX)
    if table.unknown:
        raise ConfigError(f"{path}:1: {table.unknown[0]}: found an unknown column, expected {','.join(HEADER)}")
    if not table.rows:
        raise ConfigError(f"{path}: found no rows, expected one per image")
    return [_posed(path, where, table.with_points(row)) for where, row in table.rows]


def _posed(path: Path, where: str, row: dict[str, str]) -> PosedImage:
    values = [number(where, column, row[column]) for column in HEADER[1:]]
    norm = math.hypot(*values[3:])
    if abs(norm - 1) > _UNIT:
        raise ConfigError(f"{where}: qw, qx, qy, qz: found a quaternion of length {norm:.4g}, expected length 1")
    if not row["image"]:
        raise ConfigError(f"{where}: image: found nothing, expected a file name")
    return PosedImage(where, named_file(path.parent, row["image"]), from_seven(values))
