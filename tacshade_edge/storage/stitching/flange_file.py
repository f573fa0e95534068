"""``flange.json``: the sensor's estimated pose on the flange."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from tacshade_edge.core.stitching.flange import ORDER, FoundFlange
from tacshade_edge.storage.atomic_files import disk_errors, write_whole
from tacshade_edge.types import F64

FLANGE = "flange.json"


def write_flange(folder: Path, found: FoundFlange, *, delay_seen: bool, presses: int, frames: int) -> None:
    """Write ``flange.json`` whole; create the folder if missing. Values of an unobserved delay are null.

    Raises
    ------
    DeviceError
        The folder cannot be written.
    """
    covariance = found.covariance.copy()
    if not delay_seen:
        covariance[-1] = covariance[:, -1] = np.nan
    about = {
        "flange_T_sensor": [round(value, 6) for value in found.flange_T_sensor.seven()],
        "delay_ms": round(found.delay_ms, 3) if delay_seen else None,
        "order": ORDER,
        "sigma": _numbers(np.sqrt(np.diag(covariance))),
        "covariance": [_numbers(row) for row in covariance],
        "presses": presses,
        "frames": frames,
        "left_mm": round(found.left_mm, 4),
    }
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / FLANGE, (json.dumps(about, indent=2) + "\n").encode())


def _numbers(values: F64) -> list[float | None]:
    return [float(f"{value:.4g}") if np.isfinite(value) else None for value in values.tolist()]
