"""A sensor's messages in Foxglove's schemas: positions in metres, Unix times;
values that people read stay in mm.
"""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Final, Literal

import numpy as np
from foxglove.messages import (
    Color,
    CompressedImage,
    FrameTransform,
    FrameTransforms,
    Log,
    LogLevel,
    PackedElementField,
    PackedElementFieldNumericType,
    Point3,
    PointCloud,
    Pose,
    Quaternion,
    RawImage,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    TriangleListPrimitive,
    Vector3,
)

from tacshade_edge.sensor.geometry.disc import Grid, disc_rays, skin_points
from tacshade_edge.types import F32
from tacshade_edge.types import Pose as RobotPose
from tacshade_edge.wire.binary import CloudMessage, HeightMessage
from tacshade_edge.wire.sensor_topics import Contact, Info

M_PER_MM: Final = 0.001
SKIN_CELLS_MAX: Final = 48
"""Cells along a side of the mesh; few, because encoding makes a Python object of each vertex."""

_DEEPEST_MM: Final = 3.0
# Made once: one for each vertex of each mesh would take longer than the mesh.
_COLOURS: Final = [
    Color(r=0.35 + 0.6 * t, g=0.4 + 0.45 * t, b=0.55 - 0.4 * t, a=1.0)
    for t in np.linspace(0.0, 1.0, 64)
]
_FLOAT: Final = PackedElementFieldNumericType.Float32
_CLOUD_FIELDS: Final = [
    PackedElementField(name="x", offset=0, type=_FLOAT),
    PackedElementField(name="y", offset=4, type=_FLOAT),
    PackedElementField(name="z", offset=8, type=_FLOAT),
    PackedElementField(name="object", offset=12, type=PackedElementFieldNumericType.Uint16),
]
_CLOUD_POINT: Final = np.dtype([("xyz", "<f4", 3), ("object", "<u2")])

CONTACT_SCHEMA: Final = {
    "title": "tacshade.Contact",
    "type": "object",
    # All values except the codes may be null, which the JSON Schema of viewers cannot express.
    "properties": {
        field.name: {"type": "string" if field.name.endswith("_code") else "number"}
        for field in fields(Contact)
    },
}

Frame = Literal["base", "flange", "sensor"]


def frame_name(sensor_id: str, frame: Frame) -> str:
    """The name of a frame of this sensor; each sensor has its own base,
    as their robots may differ.
    """
    return f"{sensor_id}/{frame}"


def timestamp(wall_ns: int) -> Timestamp:
    # The schema has 32 bits for the seconds; a board's clock may be set to any time.
    sec, nsec = divmod(wall_ns, 1_000_000_000)
    return Timestamp(sec=min(sec, 0xFFFFFFFF), nsec=nsec)


def image(message: HeightMessage, sensor_id: str) -> RawImage:
    """The height map as a ``32FC1`` image: h in mm at each cell, NaN outside the disc, and
    everywhere in a frame that could not be used.
    """
    rows, cols = message.height_mm.shape
    # The 0 in the message is marked as unknown by a flag, which an image lacks.
    known_mm = np.full_like(message.height_mm, np.nan) if message.invalid else message.height_mm
    return RawImage(
        timestamp=timestamp(message.wall_ns),
        frame_id=frame_name(sensor_id, "sensor"),
        width=cols,
        height=rows,
        encoding="32FC1",
        step=4 * cols,
        data=known_mm.astype("<f4", copy=False).tobytes(),
    )


def cloud(message: CloudMessage, sensor_id: str, frame: Frame = "sensor") -> PointCloud:
    """The cloud's points in m, each with the number of its object."""
    points = np.empty(len(message.labels), _CLOUD_POINT)
    points["xyz"], points["object"] = message.points_mm * np.float32(M_PER_MM), message.labels
    return PointCloud(
        timestamp=timestamp(message.wall_ns),
        frame_id=frame_name(sensor_id, frame),
        pose=Pose(position=Vector3(), orientation=Quaternion(w=1.0)),
        point_stride=_CLOUD_POINT.itemsize,
        fields=_CLOUD_FIELDS,
        data=points.tobytes(),
    )


def skin(height_mm: F32, grid: Grid, info: Info, sensor_id: str, wall_ns: int) -> SceneUpdate:
    """The skin as a mesh in m, coloured by h (rows, cols; NaN outside the disc);
    empty without a calibration.
    """
    if info.geometry is None:
        return SceneUpdate()
    every = max(1, math.ceil(max(grid.rows, grid.cols) / SKIN_CELLS_MAX))
    height_mm = height_mm[::every, ::every]
    rows, cols = height_mm.shape
    coarse = Grid(rows, cols, grid.row0, grid.col0, grid.step_px * every)
    points = (
        skin_points(height_mm, disc_rays(coarse, info.geometry.geometry), info.geometry.geometry)
        * M_PER_MM
    )
    there = np.isfinite(points).all(axis=-1)
    # Cells outside the disc have no vertex, and a triangle needs all its corners.
    number = np.cumsum(there).reshape(there.shape) - 1
    quads = there[:-1, :-1] & there[1:, :-1] & there[:-1, 1:] & there[1:, 1:]
    a, b, c, d = (
        number[i : i + quads.shape[0], j : j + quads.shape[1]][quads]
        for i in (0, 1)
        for j in (0, 1)
    )
    depth = np.clip(height_mm[there] / _DEEPEST_MM * len(_COLOURS), 0, len(_COLOURS) - 1).astype(
        int
    )
    triangles = TriangleListPrimitive(
        pose=Pose(position=Vector3(), orientation=Quaternion(w=1.0)),
        points=[Point3(x=x, y=y, z=z) for x, y, z in points[there].tolist()],
        colors=[_COLOURS[i] for i in depth.tolist()],
        # In this order the triangles face outwards.
        indices=np.stack((a, b, c, b, d, c), axis=-1).ravel().tolist(),
    )
    frame_id = frame_name(sensor_id, "sensor")
    entity = SceneEntity(
        timestamp=timestamp(wall_ns),
        frame_id=frame_id,
        id=frame_id,
        frame_locked=True,
        triangles=[triangles],
    )
    return SceneUpdate(entities=[entity])


def flange_T_sensor(info: Info, sensor_id: str, wall_ns: int) -> FrameTransforms:
    if info.geometry is None:
        return FrameTransforms()
    transform = _transform(info.geometry.flange_T_sensor, sensor_id, "flange", "sensor", wall_ns)
    return FrameTransforms(transforms=[transform])


def base_T_flange(pose: RobotPose, sensor_id: str, wall_ns: int) -> FrameTransforms:
    values = (pose.x_mm, pose.y_mm, pose.z_mm, pose.qw, pose.qx, pose.qy, pose.qz)
    return FrameTransforms(transforms=[_transform(values, sensor_id, "base", "flange", wall_ns)])


def picture(jpeg: bytes, sensor_id: str, wall_ns: int) -> CompressedImage:
    return CompressedImage(
        timestamp=timestamp(wall_ns),
        frame_id=frame_name(sensor_id, "sensor"),
        data=jpeg,
        format="jpeg",
    )


def log(topic: str, text: str, wall_ns: int, *, warns: bool) -> Log:
    """A line for the log panel, named after its topic."""
    level = LogLevel.Warning if warns else LogLevel.Info
    return Log(timestamp=timestamp(wall_ns), level=level, message=text, name=topic)


def _transform(
    values: tuple[float, ...], sensor_id: str, parent: Frame, child: Frame, wall_ns: int
) -> FrameTransform:
    x, y, z, qw, qx, qy, qz = values
    return FrameTransform(
        timestamp=timestamp(wall_ns),
        parent_frame_id=frame_name(sensor_id, parent),
        child_frame_id=frame_name(sensor_id, child),
        translation=Vector3(x=x * M_PER_MM, y=y * M_PER_MM, z=z * M_PER_MM),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
