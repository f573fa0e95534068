#!/usr/bin/env python3
"""Draw touches of a real sensor for the README: pictures with the height maps of a profile below.

::

    git clone https://github.com/Neo-manchester/Tac-VGNN out/real/Tac-VGNN
    .venv/bin/python -m tools.studies.real_sheet out/real/Tac-VGNN docs/images/real-touches.webp

The pictures are of `real_frames pins` (Apache-2.0, Wen Fan, Max Yang, Yifan Xing, Nathan Lepora and
Dandan Zhang). The calibration is made from the untouched picture alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.lab.studies.evaluate.work import reconstructor
from tacshade_edge.types import U8, Disc, Frame, HeightMap, Reconstruction
from tools.studies.real_sets import SENSOR, all_pin_frames

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NUMBERS = (2446, 2456, 865, 4963)
"""The frames that are drawn: a light and a deeper tap on a level plane,
and two on planes tilted to either side.
"""
PROFILE = "balanced"
CARD, INK, FAINT = "#11161d", "#f0f3f6", "#9aa4af"
"""Colours of the cards, which suit a white page and a black one, and of what is written on them."""
WIDTH_IN, HEIGHT_IN, DOTS_PER_IN = 9.2, 4.62, 200
WEBP_QUALITY, OPAQUE = 88, 255
COLOURS = "viridis"
GAP_IN, SCALE_IN, ROUND_IN, CAPTION_IN = 0.1, 0.72, 0.1, 0.62
PANEL_PART = 0.97
"""A panel's side as part of its card's width."""
MARGIN = 1.12
"""Half of a panel's side, in radii of the visible circle."""
CONTOUR_MM = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """A picture, uint8 (H, W), its result, and the plane's stated tilt."""

    picture: U8
    result: Reconstruction
    tilt_deg: float


def touches(clone: Path) -> tuple[list[Touch], Disc]:
    """Reconstruct the frames that are drawn; also return the visible circle."""
    free, *taps = all_pin_frames(clone)
    calibration = calibrate(SENSOR, [read_image(free.path)]).calibration
    made, drawn = reconstructor(calibration, PROFILE), []
    for number in NUMBERS:
        picture = read_image(taps[number].path)
        result = made.step(Frame(0, 0, 0, picture))
        drawn.append(Touch(picture, result, taps[number].known["tilt_deg"]))
    return drawn, calibration.geometry.disc


def draw(drawn: Sequence[Touch], disc: Disc, file: Path) -> None:
    """Draw a card for each touch, and the scale of all maps,
    into a WebP file without a background.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import to_rgb
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DOTS_PER_IN)
    figure.patch.set_alpha(0)
    canvas = FigureCanvasAgg(figure)
    top_mm = max(touch.result.depth_max_mm for touch in drawn)
    width_in = (WIDTH_IN - SCALE_IN) / len(drawn) - GAP_IN
    for k, touch in enumerate(drawn):
        left_in = k * (width_in + GAP_IN)
        card(figure, left_in, width_in)
        column(figure, touch, disc, (left_in, width_in, top_mm))
    card(figure, WIDTH_IN - SCALE_IN, SCALE_IN)
    scale(figure, top_mm)
    canvas.draw()
    rgba = np.array(canvas.buffer_rgba())
    # A page that shrinks the picture mixes in the colour of what is transparent.
    rgba[rgba[..., 3] < OPAQUE, :3] = [round(OPAQUE * part) for part in to_rgb(CARD)]
    bgra = cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA)
    cv2.imwrite(str(file), bgra, [cv2.IMWRITE_WEBP_QUALITY, WEBP_QUALITY])


def placed(figure: Figure, left_in: float, bottom_in: float, size_in: tuple[float, float]) -> Axes:
    """Axes without lines, numbers or a background at a place of the figure."""
    width_in, height_in = size_in
    place = (
        left_in / WIDTH_IN,
        bottom_in / HEIGHT_IN,
        width_in / WIDTH_IN,
        height_in / HEIGHT_IN,
    )
    axes = figure.add_axes(place)
    axes.axis("off")
    return axes


def card(figure: Figure, left_in: float, width_in: float) -> None:
    """Draw a rounded card of the figure's height."""
    from matplotlib.patches import FancyBboxPatch

    axes = placed(figure, left_in, 0, (width_in, HEIGHT_IN))
    axes.set_xlim(0, width_in)
    axes.set_ylim(0, HEIGHT_IN)
    style = f"round,pad=0,rounding_size={ROUND_IN}"
    axes.add_patch(
        FancyBboxPatch((0, 0), width_in, HEIGHT_IN, boxstyle=style, linewidth=0, facecolor=CARD)
    )


def column(figure: Figure, touch: Touch, disc: Disc, where: tuple[float, float, float]) -> None:
    """Draw a touch on its card: the picture, its map below, what was found;
    `where` is left, width, top of scale.
    """
    from matplotlib.patches import Circle

    left_in, width_in, top_mm = where
    side_in = PANEL_PART * width_in
    inset_in = left_in + (width_in - side_in) / 2
    low_in = CAPTION_IN
    above = placed(figure, inset_in, low_in + side_in, (side_in, side_in))
    below = placed(figure, inset_in, low_in, (side_in, side_in))
    dim = np.where(touch.picture > 127, 235, 0)
    inside = Circle((disc.col_c, disc.row_c), disc.radius_px, transform=above.transData)
    shown = above.imshow(dim, cmap="gray", vmin=0, vmax=255, interpolation="bilinear")
    shown.set_clip_path(inside)
    relief(below, touch.result.height, top_mm)
    reach_px = MARGIN * disc.radius_px
    for axes in (above, below):
        axes.set_xlim(disc.col_c - reach_px, disc.col_c + reach_px)
        axes.set_ylim(disc.row_c + reach_px, disc.row_c - reach_px)
    middle = (left_in + width_in / 2) / WIDTH_IN
    level = "level plane" if touch.tilt_deg < 1 else f"plane tilted by {touch.tilt_deg:.0f}°"
    found = f"{touch.result.depth_max_mm:.1f} mm deep"
    figure.text(middle, 0.40 / HEIGHT_IN, found, color=INK, fontsize=14, ha="center")
    figure.text(middle, 0.15 / HEIGHT_IN, level, color=FAINT, fontsize=11, ha="center")


def relief(axes: Axes, grid: HeightMap, top_mm: float) -> None:
    """Draw a height map in colours with contour lines."""
    rows, cols = grid.height_mm.shape
    step = grid.step_px
    extent = (
        grid.col0 - step / 2,
        grid.col0 + (cols - 0.5) * step,
        grid.row0 + (rows - 0.5) * step,
        grid.row0 - step / 2,
    )
    axes.imshow(
        grid.height_mm, extent=extent, vmin=0, vmax=top_mm, cmap=COLOURS, interpolation="bilinear"
    )
    axes.contour(
        grid.col0 + step * np.arange(cols),
        grid.row0 + step * np.arange(rows),
        grid.height_mm,
        levels=np.arange(CONTOUR_MM, top_mm, CONTOUR_MM),
        colors="white",
        linewidths=0.6,
        alpha=0.55,
    )


def scale(figure: Figure, top_mm: float) -> None:
    """Draw the scale of the maps' colours on its card."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    left_in, width_in, low_in, high_in = WIDTH_IN - SCALE_IN + 0.14, 0.14, CAPTION_IN, 4.12
    axes = placed(figure, left_in, low_in, (width_in, high_in - low_in))
    axes.axis("on")
    bar = figure.colorbar(ScalarMappable(Normalize(0, top_mm), COLOURS), cax=axes)
    bar.outline.set_visible(False)
    bar.set_ticks(range(int(top_mm) + 1))
    bar.ax.tick_params(colors=INK, labelsize=12, length=3)
    figure.text(left_in / WIDTH_IN, (high_in + 0.15) / HEIGHT_IN, "mm", color=INK, fontsize=12)


def main() -> int:
    """Reconstruct and draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clone", type=Path)
    parser.add_argument("file", type=Path, metavar="FILE.webp")
    args = parser.parse_args()
    try:
        draw(*touches(args.clone), args.file)
    except (ConfigError, DecodeError, OSError) as error:
        print(f"real_sheet.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
