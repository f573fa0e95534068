"""A sensor as MuJoCo's files: a skin with its taxels on a flange, and a scene to try it in. Pure.

MuJoCo's unit is the metre. Its contact of bodies is with an undeformed skin, a sphere or a plate,
whose force grows with the depth as that of the skin under a ball; what the skin then looks like is
for `mujoco_sensor.MujocoSensor` to find from the depths of the taxels.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Final, Literal
from xml.sax.saxutils import quoteattr

import msgspec
import numpy as np

from tacshade_edge.lab.mjcf.taxels import Taxels, taxels_of
from tacshade_edge.lab.simulator.sensor_model import (
    MAX_VISIBLE_HALF_ANGLE_DEG,
    RIM_HALF_ANGLE_DEG,
    SensorModel,
)
from tacshade_edge.lab.simulator.skin import at_height, chart_to_direction
from tacshade_edge.types import F64, I32, Calibration

NAME: Final = "tacshade"
"""The body of the flange; the names of all other parts begin with it."""
SENSOR_FILE, SCENE_FILE = "sensor.xml", "scene.xml"
_M: Final = 1e-3  # in a millimetre
_RINGS, _SPOKES = 24, 96
# Of the housing below the skin's rim, and of a pad.
_WALL_MM, _HOUSING_MM, _PAD_MM = 1.5, 30.0, 10.0
_BALL_MM, _BALL_ABOVE_MM = 6.0, 1.0
_DRAWN_INSIDE_MM = 0.05  # so that a picture shows the skin, not what bodies collide with

_SENSOR = """\
<mujoco model={model}>
  <!-- A tactile sensor. The skin's parameters are those of the text below, which MujocoSensor of
       tacshade_edge reads; change them by writing these files again. -->
  <custom>
    <text name="{name}_sensor" data={parameters}/>
  </custom>
  <asset>
    <mesh name="{name}_skin" file="skin.msh" inertia="shell"/>
    <mesh name="{name}_taxels" file="taxels.msh" inertia="shell"/>
    <material name="{name}_skin" rgba="0.13 0.13 0.14 1" specular="0.2" shininess="0.2"/>
    <material name="{name}_housing" rgba="0.85 0.85 0.87 1"/>
  </asset>
  <worldbody>
    <body name="{name}">
      <!-- The flange. Everything below is in the sensor frame. -->
      <frame pos="{pos}" quat="{quat}">
        <site name="{name}_sensor" size="0.001" rgba="0 0 0 0"/>
        <!-- Without the priority, MuJoCo would take the mean of these and the object's. -->
        <geom name="{name}_touch" {touch} group="3" rgba="0.3 0.6 0.9 0.3" mass="0.03"
              priority="1" condim="4" friction="{friction:g} 0.003 0.0001" solref="0.02 1"
              solimp="0.88 0.95 {depth:g} 0.5 1"/>
        <geom name="{name}_housing" {housing} material="{name}_housing" mass="0.05"/>
        <geom name="{name}_skin" type="mesh" mesh="{name}_skin" material="{name}_skin"
              contype="0" conaffinity="0" mass="0"/>
        <geom name="{name}_taxels" type="mesh" mesh="{name}_taxels" group="4"
              contype="0" conaffinity="0" mass="0"/>
      </frame>
    </body>
  </worldbody>
  <sensor>
    <tactile name="{name}" geom="{name}_taxels" mesh="{name}_taxels"/>
  </sensor>
</mujoco>
"""
_SCENE = """\
<mujoco model="{name} and a ball">
  <!-- A ball a millimetre above the sensor, and an actuator that presses it on: ctrl is how far it
       is to come down, in m. -->
  <include file="sensor.xml"/>
  <option timestep="0.005" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <statistic center="0 0 {apex:g}" extent="0.1"/>
  <visual>
    <headlight ambient="0.35 0.35 0.35" diffuse="0.5 0.5 0.5"/>
    <global offwidth="960" offheight="720"/>
  </visual>
  <worldbody>
    <light pos="0.1 -0.1 0.3" dir="-0.3 0.3 -1"/>
    <body name="ball" pos="0 0 {above:g}" gravcomp="1">
      <joint name="ball_down" type="slide" axis="0 0 -1" damping="1"/>
      <geom name="ball" type="sphere" size="{ball:g}" mass="0.02" rgba="0.9 0.45 0.2 0.8"/>
    </body>
  </worldbody>
  <actuator>
    <position name="ball_down" joint="ball_down" kp="3000" kv="40" ctrlrange="0 0.02"/>
  </actuator>
</mujoco>
"""


class Parameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the text of a sensor's file holds: its model, and where it stands on its flange."""

    model: SensorModel
    flange_T_sensor: tuple[float, float, float, float, float, float, float]
    version: Literal[1] = 1


def calibrated(stated: SensorModel, calibration: Calibration) -> SensorModel:
    """A stated sensor with the skin's form, camera and visible circle of a calibrated one.

    Raises ValueError for what cannot be simulated.
    """
    geometry, disc = calibration.geometry, calibration.geometry.disc
    # A calibration may find a little more than the simulator clamps.
    angle_deg = min(geometry.visible_half_angle_deg, MAX_VISIBLE_HALF_ANGLE_DEG)
    radius_mm = geometry.skin_radius_mm
    if geometry.skin == "pad":
        # A pad of the model is one of the size of a dome with the same visible circle.
        angle_deg = stated.visible_half_angle_deg
        radius_mm = geometry.visible_radius_mm / math.sin(math.radians(angle_deg))
    return replace(
        stated,
        skin=geometry.skin,
        skin_radius_mm=radius_mm,
        camera_distance_mm=geometry.camera_distance_mm,
        visible_half_angle_deg=angle_deg,
        image_height_px=calibration.image_height_px,
        image_width_px=calibration.image_width_px,
        row_c=disc.row_c,
        col_c=disc.col_c,
        disc_radius_px=disc.radius_px,
        # Nothing here draws the print, whose size must fit the skin's.
        pitch_mm=stated.pitch_mm * radius_mm / stated.skin_radius_mm,
        bulge=0.0,
    )


def files(parameters: Parameters, name: str = NAME) -> dict[str, bytes]:
    """The files of a sensor by their names: MJCF of the sensor and of a scene, and two meshes."""
    model, taxels = parameters.model, taxels_of(parameters.model.geometry)
    points, triangles = _skin_mesh(model)
    # Of a sensor that points along its flange's z.
    apex_mm = parameters.flange_T_sensor[2] + model.geometry.apex_z_mm
    return {
        SENSOR_FILE: _sensor(parameters, name).encode(),
        SCENE_FILE: _SCENE.format(
            name=name,
            apex=apex_mm * _M,
            above=(apex_mm + _BALL_MM + _BALL_ABOVE_MM) * _M,
            ball=_BALL_MM * _M,
        ).encode(),
        "skin.msh": _msh(points, triangles),
        "taxels.msh": _msh(taxels.points_mm.reshape(-1, 3), _taxel_triangles(taxels)),
    }


def _sensor(parameters: Parameters, name: str) -> str:
    model = parameters.model
    x, y, z, *q = parameters.flange_T_sensor
    rim_mm, rim_z_mm = _rim(model)
    middle_mm, half_mm = rim_z_mm - _HOUSING_MM / 2, _HOUSING_MM / 2
    radius_mm = rim_mm + _WALL_MM
    if model.skin == "pad":
        touch = _cylinder(rim_mm, -_PAD_MM / 2, _PAD_MM / 2)
        middle_mm -= _PAD_MM  # below the pad, which alone is to touch
    else:
        touch = f'type="sphere" size="{model.skin_radius_mm * _M:g}"'
        # Wide enough to hold the rest of the sphere.
        radius_mm = max(radius_mm, model.skin_radius_mm)
    return _SENSOR.format(
        model=quoteattr(name),
        name=name,
        parameters=quoteattr(msgspec.json.encode(parameters).decode()),
        pos=" ".join(f"{each * _M:.9g}" for each in (x, y, z)),
        quat=" ".join(f"{each:.9g}" for each in q),
        touch=touch,
        housing=_cylinder(radius_mm, middle_mm, half_mm),
        # The simulator knows the ratio of friction to the skin's stiffness along itself and across,
        # which is taken to be the same both ways.
        friction=model.coulomb,
        depth=model.geometry.size_mm / 5 * _M,
    )


def _cylinder(radius_mm: float, middle_z_mm: float, half_mm: float) -> str:
    size, at = f"{radius_mm * _M:g} {half_mm * _M:g}", f"0 0 {middle_z_mm * _M:g}"
    return f'type="cylinder" size="{size}" pos="{at}"'


def _rim(model: SensorModel) -> tuple[float, float]:
    """Radius and z of the skin's rim, mm."""
    radius_mm, size_mm = model.form_mm
    angle = math.radians(RIM_HALF_ANGLE_DEG)
    if math.isinf(radius_mm):
        return 2 * size_mm * math.tan(angle / 2), 0.0
    return radius_mm * math.sin(angle), radius_mm * math.cos(angle)


def _skin_mesh(model: SensorModel) -> tuple[F64, I32]:
    """Points (N, 3) in mm and triangles (M, 3) of the undeformed skin up to its rim."""
    radius_mm, size_mm = model.form_mm
    reach_mm = 2 * size_mm * math.tan(math.radians(RIM_HALF_ANGLE_DEG) / 2)
    ring = np.linspace(0, reach_mm, _RINGS + 1)[1:, None]
    around = np.linspace(0, 2 * math.pi, _SPOKES, endpoint=False)
    x, y = (np.append(0.0, (ring * turned(around)).ravel()) for turned in (np.cos, np.sin))
    points = at_height(
        chart_to_direction(x, y, radius_mm), np.full(len(x), _DRAWN_INSIDE_MM), radius_mm
    )
    here = 1 + np.arange(_RINGS * _SPOKES).reshape(_RINGS, _SPOKES)
    after = np.roll(here, -1, axis=1)
    inner = np.stack((np.zeros_like(here[0]), here[0], after[0]), axis=-1)
    first = np.stack((here[:-1], here[1:], after[1:]), axis=-1)
    second = np.stack((here[:-1], after[1:], after[:-1]), axis=-1)
    return points, np.concatenate([each.reshape(-1, 3) for each in (inner, first, second)]).astype(
        np.int32
    )


def _taxel_triangles(taxels: Taxels) -> I32:
    """Triangles between the taxels on the skin, so that MuJoCo can shade them by what they feel."""
    number = np.full(taxels.grid.rows * taxels.grid.cols, -1)
    number[taxels.cell] = np.arange(len(taxels.cell)) + len(taxels.cell)  # of the second shell
    grid = number.reshape(taxels.grid.rows, taxels.grid.cols)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]
    both = np.concatenate(
        [np.stack(each, axis=-1).reshape(-1, 3) for each in ((a, b, d), (a, d, c))]
    )
    return both[(both >= 0).all(axis=1)].astype(np.int32)


def _msh(points_mm: F64, triangles: I32) -> bytes:
    """MuJoCo's own binary format, which keeps the order of the points."""
    head = np.array((len(points_mm), 0, 0, len(triangles)), "<i4")
    body = (points_mm * _M).astype("<f4")
    return head.tobytes() + body.tobytes() + triangles.astype("<i4").tobytes()
