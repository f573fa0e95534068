"""Draw the rows of the paper's Fig. 6, a column for each object; only drawing imports `PACKAGES`, and only here."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tacshade_edge.core.geometry.disc import disc_rays, skin_points
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.core.image.preprocess import GreyMapper, GreyMaps, Preprocessor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.truth import Truth
from tacshade_edge.studies.evaluate.score import CloudScore, KnownTruth, score_cloud
from tacshade_edge.studies.evaluate.work import SensorName, reconstructor, scenes
from tacshade_edge.types import F32, F64, U8, Calibration, Disc, Frame, Reconstruction

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLUMNS = 5
DEPTH_MM = 3.0
PACKAGES = ("matplotlib", "skimage")
HEIGHT_COLOURS = "YlGnBu"  # pale where nothing is pressed, so that the skin's shading shows
FOUND_COLOUR, TRUE_COLOUR = "#e4572e", "#3d6fb4"
# Enough to show the shapes, few enough to keep a page small.
_CLOUD_POINTS, _SKIN_CELLS = 900, 100
_OBJECT_HEIGHT_MM, _GAP_MM = 8.0, 4.0  # how much of an object is drawn, and how far above the skin


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """The contents of one press's column."""

    title: str
    press: Press
    image: U8
    maps: GreyMaps
    result: Reconstruction
    truth: Truth
    score: CloudScore


def columns(name: SensorName, calibration: Calibration, profile: str, objects: Sequence[str]) -> list[Column]:
    """Press the first `COLUMNS` objects `DEPTH_MM` deep near the middle of a sensor."""
    sensor = name.make()
    solve = reconstructor(calibration, profile)
    preprocessor = Preprocessor(calibration, PROFILES["paper"])  # its maps are as fine as the image
    grey_mapper = GreyMapper(preprocessor)
    made = []
    for object_name in objects[:COLUMNS]:
        scene = scenes(sensor.model, name.seed, object_name, (DEPTH_MM,))[0]
        frame = sensor.frame((scene.press,), scene.noise_seed)
        result, truth = solve.step(Frame(0, 0, 0, frame.image)), frame.truth()
        score = score_cloud(result.cloud.points_mm, KnownTruth.of(truth).points_mm, truth.depth_max_mm)
        maps = grey_mapper.maps(preprocessor.preprocess(to_grey(frame.image)))
        made.append(Column(object_name.replace("_", " "), scene.press, frame.image, maps, result, truth, score))
    return made


def draw(made: Sequence[Column], calibration: Calibration, profile: str, dpi: int = 100) -> bytes:
    """Draw Fig. 6 as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    count = len(made)
    figure = Figure(figsize=(0.9 + 2.9 * count, 12.6), dpi=dpi, facecolor="white")
    canvas = FigureCanvasAgg(figure)
    margins = {"left": 0.055, "right": 0.945, "top": 0.945, "bottom": 0.035, "hspace": 0.09}
    rows = figure.add_gridspec(6, 1, **margins, height_ratios=(2.3, 2.6, 1.0, 1.5, 1.7, 2.2))
    top_mm = max(max(float(np.nanmax(c.truth.height_mm)), float(np.nanmax(c.result.height.height_mm))) for c in made)
    bars = []
    for k, column in enumerate(made):
        cells = [rows[i].subgridspec(1, count, wspace=0.08)[k] for i in range(6)]
        _scene(figure.add_subplot(cells[0], projection="3d"), column, calibration)
        box = cells[0].get_position(figure)
        figure.text((box.x0 + box.x1) / 2, box.y1, column.title, ha="center", va="center", fontsize=13)
        _camera(figure.add_subplot(cells[1]), column, calibration.geometry.disc)
        bars.append(_grey_maps(figure, cells[2], column))
        bars.append(_heights(figure, cells[3], column, calibration.geometry.disc, top_mm))
        _skin(figure.add_subplot(cells[4], projection="3d"), column, calibration, top_mm)
        _clouds(figure.add_subplot(cells[5], projection="3d"), column)
    names = ("scene", "camera image", "grey maps", "height (greatest)", "skin (eq. 2)", "cloud (mm)")
    for i, text in enumerate(names):
        box = rows[i].get_position(figure)
        figure.text(0.022, (box.y0 + box.y1) / 2, text, rotation=90, ha="center", va="center", fontsize=12)
    _colour_bar(figure, bars[0], rows[2].get_position(figure), "grey levels")
    _colour_bar(figure, bars[1], rows[3].get_position(figure), "h (mm)")
    figure.suptitle(f"Profile {profile}, pressed {DEPTH_MM:g} mm deep", fontsize=14, y=0.985)
    return _png(canvas)


def _scene(axes: Any, column: Column, calibration: Calibration) -> None:
    """Draw the object above the skin that it will press, both to scale."""
    from matplotlib.colors import LightSource

    r, theta = calibration.geometry.skin_radius_mm, np.radians(calibration.geometry.visible_half_angle_deg)
    polar, turn = np.meshgrid(np.linspace(0, theta, 24), np.linspace(0, 2 * np.pi, 61))
    x, y, z = r * np.sin(polar) * np.cos(turn), r * np.sin(polar) * np.sin(turn), r * np.cos(polar)
    light = LightSource(azdeg=315, altdeg=50)
    axes.plot_surface(
        x, y, z, color="#c9c4b8", lightsource=light, rstride=1, cstride=1, linewidth=0, antialiased=False, alpha=0.9
    )
    vertices, faces = _object_mesh(column.press)
    lowest = float(vertices[:, 2].min())
    vertices += (column.press.x_mm, column.press.y_mm, r + _GAP_MM - lowest)
    axes.plot_trisurf(
        *vertices.T, triangles=faces, color="#5b8ff9", lightsource=light, linewidth=0, antialiased=False, zorder=10
    )
    reach = r * np.sin(theta)
    _bounds(axes, (-reach, reach), (-reach, reach), (r * np.cos(theta), r + _GAP_MM + _OBJECT_HEIGHT_MM), grow=1.3)
    axes.view_init(elev=28, azim=-60)
    axes.set_axis_off()


def _object_mesh(press: Press) -> tuple[F64, Any]:
    """Triangles in mm of the press's shape up to a height, turned and scaled but not moved."""
    from skimage.measure import marching_cubes

    step, half = 0.35, 13.0
    axis, up = np.arange(-half, half + step, step), np.arange(-2 * step, _OBJECT_HEIGHT_MM / press.scale, step)
    x, y, z = np.meshgrid(axis, axis, up, indexing="ij")
    points = np.stack((x.ravel(), y.ravel(), z.ravel()), axis=1)
    inside = np.maximum(press.shape.sdf(points), points[:, 2] - up[-3]).reshape(x.shape)
    vertices, faces, _, _ = marching_cubes(inside, 0.0, spacing=(step, step, step))
    vertices = (vertices - (half, half, -up[0])) * press.scale
    a = np.radians(press.rotation_deg)
    turn = np.array(((np.cos(a), np.sin(a), 0), (-np.sin(a), np.cos(a), 0), (0, 0, 1)))
    return vertices @ turn, faces


def _crop(values: Any, disc: Disc, grid: tuple[float, float, float]) -> Any:
    """Crop a map on a grid (row0, col0, step) to the square around the visible disc."""
    row0, col0, step = grid
    low_r, high_r = ((disc.row_c + s * (disc.radius_px + 4) - row0) / step for s in (-1, 1))
    low_c, high_c = ((disc.col_c + s * (disc.radius_px + 4) - col0) / step for s in (-1, 1))
    return values[max(round(low_r), 0) : round(high_r) + 1, max(round(low_c), 0) : round(high_c) + 1]


def _camera(axes: Any, column: Column, disc: Disc) -> None:
    axes.imshow(_crop(to_grey(column.image), disc, (0, 0, 1)), cmap="gray", vmin=0, vmax=255)
    axes.set_axis_off()


def _grey_maps(figure: Figure, cell: Any, column: Column) -> Any:
    """Draw g0, g and g_d side by side in grey levels, g_d around the middle grey."""
    maps, shown = column.maps, None
    pair = ((maps.g0, "$g_0$"), (maps.g, "$g$"), (maps.g_d + np.float32(127.5), "$g_d$ + 127"))
    for k, (values, name) in enumerate(pair):
        axes = figure.add_subplot(cell.subgridspec(1, 3, wspace=0.05)[k])
        grey = np.where(maps.inside, values, np.nan)
        shown = axes.imshow(grey, cmap="gray", vmin=0, vmax=255, interpolation="antialiased")
        axes.set_title(name, fontsize=9, pad=2)
        axes.set_axis_off()
    return shown


def _heights(figure: Figure, cell: Any, column: Column, disc: Disc, top_mm: float) -> Any:
    """Draw found and true h on one scale, with the outline of the contact."""
    found, shown = column.result.height, None
    pair = (
        (found.height_mm, found.contact, (found.row0, found.col0, found.step_px), "found"),
        (column.truth.height_mm, column.truth.contact, (0.0, 0.0, 1.0), "true"),
    )
    for k, (height, contact, grid, name) in enumerate(pair):
        axes = figure.add_subplot(cell.subgridspec(1, 2, wspace=0.05)[k])
        height, contact = _crop(height, disc, grid), _crop(contact, disc, grid)
        shown = axes.imshow(height, cmap=HEIGHT_COLOURS, vmin=0, vmax=top_mm, interpolation="nearest")
        if contact.any() and not contact.all():
            axes.contour(contact, levels=[0.5], colors="black", linewidths=0.8)
        axes.set_title(f"{name}: {np.nanmax(height):.2f} mm", fontsize=9, pad=2)
        axes.set_axis_off()
    return shown


def _skin(axes: Any, column: Column, calibration: Calibration, top_mm: float) -> None:
    """Draw the reconstructed skin, coloured by h."""
    from matplotlib import colormaps

    solve = reconstructor(calibration, column.result.profile)
    rays = disc_rays(solve.grid, calibration.geometry)
    height = column.result.height.height_mm
    points = skin_points(height, rays, calibration.geometry)
    every = max(1, round(min(height.shape) / _SKIN_CELLS))
    points, height = points[::every, ::every], height[::every, ::every]
    colours = colormaps[HEIGHT_COLOURS](np.nan_to_num(height) / top_mm)
    axes.plot_surface(
        points[..., 0], points[..., 1], points[..., 2],
        facecolors=colours, rstride=1, cstride=1, linewidth=0, antialiased=False, shade=True,
    )  # fmt: skip
    r, theta = calibration.geometry.skin_radius_mm, np.radians(calibration.geometry.visible_half_angle_deg)
    reach = r * np.sin(theta)
    _bounds(axes, (-reach, reach), (-reach, reach), (r * np.cos(theta), r), grow=1.45)
    axes.view_init(elev=38, azim=-60)
    axes.set_axis_off()


def _clouds(axes: Any, column: Column) -> None:
    """Draw found and true contact points."""
    true, found = column.truth.points_mm, column.result.cloud.points_mm
    for points, colour, name in ((true, TRUE_COLOUR, "true"), (found, FOUND_COLOUR, "found")):
        some = _thinned(points)
        axes.scatter(*some.T, s=2.5, c=colour, label=name, depthshade=False, linewidths=0)
    both = np.concatenate((true, found))
    low, high = both.min(axis=0), both.max(axis=0)
    half = 0.5 * max(float((high - low)[:2].max()), 4.0)
    middle = 0.5 * (low + high)
    x, y = ((middle[k] - half, middle[k] + half) for k in (0, 1))
    _bounds(axes, x, y, (float(low[2]) - 0.3, float(high[2]) + 0.3), grow=1.12)
    axes.view_init(elev=30, azim=-60)
    axes.tick_params(labelsize=6, pad=-3)
    axes.locator_params(nbins=4)
    axes.locator_params(axis="z", nbins=3)
    axes.legend(loc="upper left", fontsize=8, markerscale=4, frameon=False, handletextpad=0.1, borderpad=0)
    text = "no contact found"
    if len(found):
        text = f"ME {column.score.me_mm:.2f} mm, SD {100 * column.score.sd:.0f} %"
    axes.text2D(0.5, -0.05, text, transform=axes.transAxes, ha="center", fontsize=10)


def _thinned(points: F32) -> F32:
    """A random subset of points, the same each time."""
    if len(points) <= _CLOUD_POINTS:
        return points
    return points[np.random.default_rng(0).permutation(len(points))[:_CLOUD_POINTS]]


def _bounds(axes: Any, x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], grow: float) -> None:
    """Give the three axes one scale, and more room than their cell, which a 3-D view does not fill."""
    box = axes.get_position()
    width, height = grow * box.width, grow * box.height
    axes.set_position((box.x0 - (width - box.width) / 2, box.y0 - (height - box.height) / 2, width, height))
    axes.patch.set_visible(False)
    axes.set(xlim=x, ylim=y, zlim=z)
    axes.set_box_aspect((x[1] - x[0], y[1] - y[0], z[1] - z[0]), zoom=1.15)


def _colour_bar(figure: Figure, shown: Any, box: Any, text: str) -> None:
    axes = figure.add_axes((0.953, box.y0, 0.008, box.height))
    bar = figure.colorbar(shown, cax=axes)
    bar.set_label(text, fontsize=9)
    bar.ax.tick_params(labelsize=8)


def _png(canvas: Any) -> bytes:
    """Encode in 256 dithered colours: a third of the bytes without a visible difference."""
    from PIL import Image  # comes with matplotlib

    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    palette = picture.quantize(256, method=Image.Quantize.MAXCOVERAGE)  # keeps white white
    stream = io.BytesIO()
    picture.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG).save(stream, format="png", optimize=True)
    return stream.getvalue()
