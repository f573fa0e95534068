"""Every text file that a person writes may begin with a byte order mark, as on Windows."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tacshade_edge.calibration.files.indenter_file import read_indenters
from tacshade_edge.calibration.files.labels import read_labels
from tacshade_edge.calibration.files.press_table import press_rows
from tacshade_edge.calibration.files.sensor_file import read_sensor
from tacshade_edge.cli.commands.dashboard import read_token
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.meshes import read_stl
from tacshade_edge.mqtt.links import password_in
from tacshade_edge.recording.frame_table import read_poses, read_table
from tacshade_edge.settings import strict_yaml

STL = """solid a
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid a
"""
READERS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "password": ("s3crét\n", lambda path: password_in(path, "mqtt.password_file")),
    "token": ("abcdefghijklmnop\n", read_token),
    "settings": ("sensor_id: a\n", lambda path: strict_yaml.read(path).value),
    "SENSOR.yaml": ("skin_radius_mm: 20\nvisible_half_angle_deg: 60\n", read_sensor),
    "INDENTERS.yaml": (
        "b: {shape: ball, radius_mm: 3}\n",
        lambda path: sorted(read_indenters(path)),
    ),
    "PRESSES.csv": (
        "image,indenter,radius_mm,depth_mm,x_mm,y_mm\na.png,ball,3,1,,\n",
        press_rows,
    ),
    "LABELS.csv": ("image,depth_mm\na.png,1\n", lambda path: read_labels(path, path.parent)),
    "POSES.csv": (
        "image,x_mm,y_mm,z_mm,qw,qx,qy,qz\na.png,1,2,3,1,0,0,0\n",
        lambda path: [one.base_T_flange.seven() for one in read_poses(path)],
    ),
    "frames.csv": (
        "image,t_ns,x_mm,y_mm,z_mm,qw,qx,qy,qz\n0.png,0,,,,,,,\n",
        lambda path: read_table(path)[:],
    ),
    "mesh": (STL, lambda path: np.asarray(read_stl(path)).tolist()),
}
NOT_UTF_16 = {"frames.csv", "mesh"}
"""Programs write these, in ASCII."""


@pytest.mark.parametrize("name", READERS)
@pytest.mark.parametrize("ends", ["\n", "\r\n"])
def test_a_mark_is_no_part_of_the_text(tmp_path: Path, name: str, ends: str) -> None:
    text, read = READERS[name]
    path = tmp_path / "file"
    path.write_bytes(text.encode())
    plain = read(path)
    marked = text.replace("\n", ends)
    path.write_bytes(codecs.BOM_UTF8 + marked.encode())
    assert read(path) == plain
    if name not in NOT_UTF_16:
        for mark, encoding in (
            (codecs.BOM_UTF16_LE, "utf-16-le"),
            (codecs.BOM_UTF16_BE, "utf-16-be"),
        ):
            path.write_bytes(mark + marked.encode(encoding))
            assert read(path) == plain


@pytest.mark.parametrize("name", sorted(READERS.keys() - NOT_UTF_16))
def test_what_no_mark_announces_and_a_power_cuts_zero_bytes_are_refused(
    tmp_path: Path, name: str
) -> None:
    text, read = READERS[name]
    text = text.replace("é", "e")
    path = tmp_path / "file"
    for data in (text.encode("utf-16-le"), text.encode("utf-16-be"), bytes(len(text))):
        path.write_bytes(data)
        with pytest.raises(ConfigError) as refusal:
            read(path)
        assert "\n" not in str(refusal.value)
