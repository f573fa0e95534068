"""What `demo` shows of a reconstruction: one line, and a small map of characters."""

from __future__ import annotations

import numpy as np

from tacshade_edge.types import HeightMap, Reconstruction

MAP_COLS, MAP_ROWS = 48, 20  # a character is about twice as high as it is wide
_RAMP = " .:-=+*#%@"
_FULL_SCALE_MM = 4.0


def status_line(result: Reconstruction, pressed_mm: float, fps: float) -> str:
    """One line for a person; `pressed_mm` is the true depth of the press, 0 without one."""
    if not result.valid:
        return f"invalid: {result.reason}"
    touch = "contact" if result.contact else "no contact"
    objects = f"{len(result.objects)} object{'' if len(result.objects) == 1 else 's'}"
    depth = f"depth {result.depth_max_mm:5.2f} mm (pressed {pressed_mm:4.2f})"
    return f"{touch:<10}  {depth}  {objects}  {fps:4.1f} fps  {result.profile}"


def character_map(height: HeightMap) -> list[str]:
    """The visible disc as `MAP_ROWS` lines: a space outside, `.` to `@` for 0 to 4 mm and more inside."""
    rows, cols = height.height_mm.shape
    # a view of the disc alone: most of a wide image is surround
    inside_rows, inside_cols = np.nonzero(np.isfinite(height.height_mm))
    if inside_rows.size == 0:
        return [" " * MAP_COLS] * MAP_ROWS
    pick_rows = np.linspace(inside_rows.min(), inside_rows.max(), MAP_ROWS).round().astype(int).clip(0, rows - 1)
    pick_cols = np.linspace(inside_cols.min(), inside_cols.max(), MAP_COLS).round().astype(int).clip(0, cols - 1)
    picked = height.height_mm[np.ix_(pick_rows, pick_cols)]
    steps = np.nan_to_num(picked, nan=0.0).clip(0, _FULL_SCALE_MM) / _FULL_SCALE_MM
    level = np.where(np.isnan(picked), 0, 1 + (steps * (len(_RAMP) - 2)).round().astype(int))
    return ["".join(_RAMP[i] for i in line) for line in level]
