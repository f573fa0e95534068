"""Numbers at their ends in what people and robots write: a table or description gives finite
numbers, or is refused in one line that names the place.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.painted_sensor import TOUCHED
from tacshade_edge.calibration.files.indenter_file import read_indenters
from tacshade_edge.calibration.files.labels import read_labels
from tacshade_edge.calibration.files.press_table import read_presses
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.calibration.indenters import stated_ball
from tacshade_edge.errors import ConfigError
from tacshade_edge.recording.frame_table import read_poses, read_table
from tacshade_edge.settings import load

RADIUS_MM, LONG = 20.0, 1000
EXTREMES = (
    *("nan", "-nan", "inf", "-inf", ".nan", ".inf", "1e309", "-1e309", "1e308", "1e30", "-1e30"),
    *(
        "5e-324",
        "-5e-324",
        "1e-310",
        "1e-300",
        "0",
        "-0.0",
        "-1",
        "1000001",
        "1_0",
        "0x10",
        "\u0663",
    ),
    *(str(2**53), str(2**63), str(2**64), str(10**400), "9" * 5000, "1e", "", "~", "true"),
)


@dataclass(frozen=True)
class Kind:
    """A file with right numbers, and what is made of it."""

    name: str
    text: str
    read: Callable[[Path], object]


def presses(path: Path) -> object:
    """The presses, and how deep each ball is in the skin, where it may touch at all."""
    found = []
    for each in read_presses(path)[0]:
        at_mm = each.x_mm or 0.0, each.y_mm or 0.0
        found.append((each.depth_mm, each.radius_mm, *at_mm))
        if math.hypot(*at_mm) < RADIUS_MM:
            ball = stated_ball(RADIUS_MM, *at_mm, each.depth_mm, each.radius_mm)
            found.append((ball.z_mm, ball.depth_max_mm(RADIUS_MM), ball.first_touch_mm(RADIUS_MM)))
    return found


def frames(path: Path) -> object:
    return [(row.t_ns, row.pose and asdict(row.pose)) for row in read_table(path)]


def poses(path: Path) -> object:
    found = [each.base_T_flange for each in read_poses(path)]
    return [(each.rotation, each.translation_mm) for each in found]


KINDS = {
    each.name: each
    for each in (
        Kind(
            "PRESSES.csv",
            "image,indenter,radius_mm,depth_mm,x_mm,y_mm\na.png,ball,4.5,2.5,1.5,-3.5\n",
            presses,
        ),
        Kind(
            "LABELS.csv",
            "image,depth_mm,tilt_x_deg,force_z_n\na.png,1.5,-20.5,3.5\n",
            lambda path: [dict(each.known) for each in read_labels(path, path.parent)],
        ),
        Kind(
            "POSES.csv",
            "image,x_mm,y_mm,z_mm,qw,qx,qy,qz\na.png,10.5,-20.5,30.5,0.6,0.0,0.8,0.0\n",
            poses,
        ),
        Kind(
            "frames.csv",
            "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz\n"
            "a.png,500,10.5,-20.5,30.5,0.6,0.0,0.8,0.0\n"
            "a.png,33333833,10.5,-20.5,30.5,0.6,0.0,0.8,0.0\n",
            frames,
        ),
        Kind(
            "SENSOR.yaml",
            "skin_radius_mm: 20.5\nvisible_half_angle_deg: 60.5\ncamera_distance_mm: 15.5\n"
            "alpha: 12.5\nflange_T_sensor: [1.5, 2.5, 3.5, 0.6, 0.0, 0.8, 0.0]\n"
            "visible_circle: {row_px: 120.5, col_px: 160.5, radius_px: 100.5}\n"
            "print: {pitch_mm: 1.5, pin_length_mm: 2.5}\n",
            lambda path: asdict(read_sensor(path)),
        ),
        Kind(
            "INDENTERS.yaml",
            "a: {shape: ball, radius_mm: 4.5}\nb: {shape: bar, radius_mm: 3.5, length_mm: 9.5}\n"
            "c: {shape: cone, angle_deg: 90.5, radius_mm: 5.5}\n",
            lambda path: [
                each if isinstance(each, float) else each.triangles_mm
                for each in read_indenters(path).values()
            ],
        ),
        Kind(
            "config.yaml",
            "source: {kind: files, path: a.png, fps: 30.5}\n"
            "profile: auto\nlatency_budget_ms: 20.5\n"
            "recorder: {pre_roll_s: 10.5}\nmqtt: {port: 1883}\n",
            lambda path: load(path).settings.recorder.pre_roll_s,
        ),
    )
}
_NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?![\w.])")


def numbers(value: Any) -> Iterator[float]:
    """Every number in what was read."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, (list, tuple)):
        for each in value:
            yield from numbers(each)
    elif isinstance(value, np.ndarray):
        yield from value.ravel().tolist()
    elif isinstance(value, (int, float)) and not isinstance(value, bool):
        yield value


@pytest.mark.slow
@pytest.mark.parametrize("name", KINDS)
@given(place=st.integers(0, 30), extreme=st.sampled_from(EXTREMES))
def test_a_number_at_its_end_is_finite_or_refused(name: str, place: int, extreme: str) -> None:
    kind = KINDS[name]
    found = list(_NUMBER.finditer(kind.text))
    begin, end = found[place % len(found)].span()
    with TemporaryDirectory(dir="/dev/shm") as folder:
        path = Path(folder, kind.name)
        cv2.imwrite(str(path.parent / "a.png"), TOUCHED)
        path.write_text(kind.text[:begin] + extreme + kind.text[end:], encoding="utf-8")
        said = f"{path}:1: "
        with np.errstate(all="raise", under="ignore"):
            try:
                assert all(map(math.isfinite, numbers(kind.read(path)))), extreme
            except ConfigError as error:
                said = str(error)
        assert "\n" not in said
        assert said.startswith(str(path))
        assert len(said) < LONG


@pytest.mark.parametrize("name", KINDS)
def test_the_right_numbers_are_read(name: str, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "a.png"), TOUCHED)
    (tmp_path / name).write_text(KINDS[name].text)
    assert list(numbers(KINDS[name].read(tmp_path / name)))
