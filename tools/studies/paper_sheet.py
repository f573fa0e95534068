"""Eight presses on one sheet: the picture, g_d, g_h, the paper's map, the network's map,
the truth.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from tacshade_edge.lab.simulator.press import PAPER_OBJECTS
from tacshade_edge.lab.simulator.sensor_model import random_model
from tacshade_edge.lab.simulator.tacshade import TACSHADE
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.lab.studies.evaluate.work import PRESSES, REFERENCES, calibrated_sensor
from tacshade_edge.lab.studies.markdown import new_figure
from tacshade_edge.sensor.depth.hybrid_sfs import finite_shape_grey
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, Bool, Frame
from tools.studies.identified import READING, tacshade_presses
from tools.studies.paper_readings import PaperMapper, PressedObject, Reading, pressed_object

IDENTIFIED, SENSOR_5 = "TacShade", "sensor 5"
SHEET = (
    *((IDENTIFIED, name) for name in PAPER_OBJECTS),
    *((SENSOR_5, name) for name in ("cube", "small_crescent", "ball")),
)
"""Table I's objects on the identified TacShade, and three
of them on a sensor where the method fails on two.
"""
DEPTH_MM = 3.0
COLUMNS = ("picture", "g_d, eq. 9", "g_h, eq. 10", "paper, own α", "accurate", "truth")
SIDE_PX = 140
COLOURS = 200


@dataclass(frozen=True, slots=True, eq=False)
class _Map:
    """Values to draw, the span of their colours, and the cells whose outline is drawn;
    NaN stays white.
    """

    values: F32
    span: tuple[float, float]
    colours: str
    outline: Bool | None = None


def sheet() -> bytes:
    """Draw the sheet as a PNG of few colours."""
    from PIL import Image  # matplotlib needs it too

    size_in = SIDE_PX / 100
    figure, axes = new_figure(
        len(SHEET), len(COLUMNS), len(COLUMNS) * size_in, len(SHEET) * size_in
    )
    for axis, title in zip(axes[0], COLUMNS, strict=True):
        axis.set_title(title, fontsize=9)
    for line, (label, maps) in zip(axes, _lines(), strict=True):
        for axis, each in zip(line, maps, strict=True):
            _draw(axis, each)
        line[0].set_ylabel(label, fontsize=8)
    stream, drawn = io.BytesIO(), io.BytesIO()
    figure.savefig(drawn, format="png")
    Image.open(drawn).convert("RGB").quantize(COLOURS).save(stream, "PNG", optimize=True)
    return stream.getvalue()


def _lines() -> Iterator[tuple[str, list[_Map]]]:
    sensors = {
        IDENTIFIED: (SimulatedSensor(TACSHADE), READING),
        SENSOR_5: (SimulatedSensor(random_model(5)), Reading()),
    }
    for title, (sensor, reading) in sensors.items():
        calibration = calibrated_sensor(sensor, 0, REFERENCES, PRESSES).calibration
        mapper = PaperMapper(calibration, reading.profile)
        accurate = make_reconstructor(calibration, PROFILES["accurate"])
        names = [name for at, name in SHEET if at == title]
        if title == IDENTIFIED:
            pressed = [one for one in tacshade_presses(sensor) if one.name in names]
        else:
            pressed = [pressed_object(sensor, name, DEPTH_MM) for name in names]
        for one in pressed:
            maps = _maps(mapper, accurate, one, saturates=reading.saturates)
            yield f"{one.name.replace('_', ' ')}, {title}", maps


def _maps(
    mapper: PaperMapper, accurate: Reconstructor, one: PressedObject, *, saturates: bool
) -> list[_Map]:
    maps = mapper.maps(one.image)
    made = mapper.made(maps, one.truth.depth_max_mm, saturates=saturates)
    inside, box = maps.inside, mapper.preprocessor.window
    most = float(np.abs(maps.g_d[inside]).max())
    result = accurate.step(Frame(0, 0, 0, one.image))
    cells = result.height.contact.shape[::-1]

    def seen(values: F32) -> F32:
        return np.where(inside, values, np.nan).astype(np.float32)

    def to_map(values: Any) -> Any:
        """Sample an image's values on the cells of the network's map."""
        height = result.height
        rows = np.rint(height.row0 + height.step_px * np.arange(cells[1])).astype(int)
        cols = np.rint(height.col0 + height.step_px * np.arange(cells[0])).astype(int)
        return values[np.ix_(rows, cols)]

    span_mm = (0.0, one.truth.depth_max_mm)
    picture = box.cut(cv2.cvtColor(one.image, cv2.COLOR_BGR2GRAY)).astype(np.float32)
    return [
        _Map(picture, (0, 255), "gray"),
        _Map(seen(maps.g_d), (-most, most), "RdBu_r"),
        _Map(seen(finite_shape_grey(made.maps)[0]), (0, 1), "viridis"),
        _Map(seen(made.height_mm), span_mm, "viridis", made.contact),
        _Map(result.height.height_mm, span_mm, "viridis", result.height.contact),
        _Map(to_map(one.truth.height_mm), span_mm, "viridis", to_map(one.truth.contact)),
    ]


def _draw(axis: Any, each: _Map) -> None:
    axis.imshow(each.values, cmap=each.colours, vmin=each.span[0], vmax=each.span[1])
    if each.outline is not None and each.outline.any():
        axis.contour(each.outline, levels=[0.5], colors="red", linewidths=0.7)
    axis.set_xticks([])
    axis.set_yticks([])
    axis.grid(visible=False)
    for spine in axis.spines.values():
        spine.set_visible(False)
