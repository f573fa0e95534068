#!/usr/bin/env python3
"""Draw the scene of ``simulate --mjcf`` with its ball pressed on, or the sensor that has gone half
around the disc of `follow_edge`, and the height map beside it.

::

    MUJOCO_GL=osmesa .venv/bin/python -m tools.examples.mujoco.picture mjcf/scene.xml scene.png
    MUJOCO_GL=osmesa .venv/bin/python -m tools.examples.mujoco.picture mjcf/sensor.xml edge.png

It needs a renderer: a screen, EGL, or Debian's libosmesa6.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import cv2
import mujoco
import numpy as np

import tacshade_edge as ts
from tacshade_edge.files.drawing import height_png
from tacshade_edge.types import U8
from tools.examples.mujoco.follow_edge import DISC_MM, DT_S, SPEED_MM_S, FollowEdge, velocity

SIZE_PX, DOWN_M = (360, 480), 0.006


def pressed(scene_xml: str) -> U8:
    """Press the scene's ball, and draw it."""
    model = mujoco.MjModel.from_xml_path(scene_xml)
    data = mujoco.MjData(model)
    data.ctrl[0] = DOWN_M
    mujoco.mj_step(model, data, 200)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = (0, 0, 0.01), 0.1
    camera.azimuth, camera.elevation = 120, -15
    return drawn(model, data, ts.MujocoSensor(model, data), camera)


def followed(sensor_xml: str) -> U8:
    """Follow the disc's edge half around, and draw where the sensor then is."""
    world = FollowEdge(sensor_xml)
    observed, _ = world.reset(seed=1)
    for _ in range(round(math.pi * DISC_MM / (SPEED_MM_S * DT_S))):
        observed, *_ = world.step(velocity(observed))
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = (0, -0.02, 0.01), 0.2
    camera.azimuth, camera.elevation = 150, -25
    return drawn(world.hand.model, world.hand.data, world.hand.sensor, camera)


def drawn(model: Any, data: Any, sensor: ts.MujocoSensor, camera: Any) -> U8:
    """The scene on white and the height map, side by side: uint8 (H, W, 3) BGR."""
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 0.35, 0.5
    with mujoco.Renderer(model, *SIZE_PX) as renderer:
        renderer.update_scene(data, camera)
        scene = renderer.render()[..., ::-1].copy()
        renderer.enable_segmentation_rendering()
        renderer.update_scene(data, camera)
        scene[renderer.render()[..., 0] < 0] = 255
    png = np.frombuffer(height_png(sensor.read().height_mm), np.uint8)
    heights = cv2.imdecode(png, cv2.IMREAD_COLOR)
    assert heights is not None
    scale = SIZE_PX[0] / heights.shape[0]
    heights = cv2.resize(heights, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.hstack((scene, heights))


if __name__ == "__main__":
    is_sensor = sys.argv[1].endswith("sensor.xml")
    cv2.imwrite(sys.argv[2], (followed if is_sensor else pressed)(sys.argv[1]))
