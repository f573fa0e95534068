#!/usr/bin/env python3
"""Draw the scene of ``simulate --mjcf`` with its ball pressed on, and the height map beside it.

::

    MUJOCO_GL=osmesa .venv/bin/python -m tools.examples.mujoco.picture mjcf/scene.xml scene.png

It needs a renderer: a screen, EGL, or Debian's libosmesa6.
"""

from __future__ import annotations

import sys

import cv2
import mujoco
import numpy as np

import tacshade_edge as ts
from tacshade_edge.files.drawing import height_png
from tacshade_edge.types import U8

SIZE_PX, DOWN_M = (360, 480), 0.006


def draw(scene_xml: str) -> U8:
    """Press the ball, and draw both: uint8 (H, W, 3) BGR."""
    spec = mujoco.MjSpec.from_file(scene_xml)
    sky = spec.add_texture(type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=64)
    sky.builtin, sky.rgb1, sky.rgb2 = mujoco.mjtBuiltin.mjBUILTIN_FLAT, (1, 1, 1), (1, 1, 1)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[0] = DOWN_M
    mujoco.mj_step(model, data, 200)
    camera = mujoco.MjvCamera()
    camera.lookat, camera.distance = (0, 0, 0.01), 0.1
    camera.azimuth, camera.elevation = 120, -15
    with mujoco.Renderer(model, *SIZE_PX) as renderer:
        renderer.update_scene(data, camera)
        scene = renderer.render()[..., ::-1]
    drawn = height_png(ts.MujocoSensor(model, data).read().height_mm)
    heights = cv2.imdecode(np.frombuffer(drawn, np.uint8), cv2.IMREAD_COLOR)
    assert heights is not None
    scale = SIZE_PX[0] / heights.shape[0]
    heights = cv2.resize(heights, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.hstack((scene, heights))


if __name__ == "__main__":
    cv2.imwrite(sys.argv[2], draw(sys.argv[1]))
