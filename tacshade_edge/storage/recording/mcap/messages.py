"""A sensor's values in Foxglove's schemas: lengths and positions in metres, times in Unix time, as viewers expect.

Values read only as numbers stay in mm: a pixel of the height image is h in mm. The frames of reference are
``ID/base``, ``ID/flange`` and ``ID/sensor``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PackedElementField_pb2 import PackedElementField
from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp

from tacshade_edge.types import F32, ObjectCloud

M_PER_MM: Final = 0.001
MESSAGES: Final[dict[str, Any]] = {
    "camera": CompressedImage,
    "height": RawImage,
    "cloud": PointCloud,
    "tf": FrameTransforms,
    "log": Log,
}
Frame = Literal["base", "flange", "sensor"]
_POINT: Final = np.dtype([("xyz", "<f4", 3), ("object", "<u2")])


def camera(png: bytes, sensor_id: str, wall_ns: int) -> bytes:
    """The message of a captured frame, lossless."""
    message = CompressedImage(
        timestamp=_timestamp(wall_ns), frame_id=_frame_id(sensor_id, "sensor"), data=png, format="png"
    )
    return bytes(message.SerializeToString())


def height(height_mm: F32, sensor_id: str, wall_ns: int) -> bytes:
    """The message of a height map: each cell's h in mm as ``32FC1``; NaN outside the disc."""
    rows, cols = height_mm.shape
    message = RawImage(
        timestamp=_timestamp(wall_ns),
        frame_id=_frame_id(sensor_id, "sensor"),
        width=cols,
        height=rows,
        encoding="32FC1",
        step=4 * cols,
        data=height_mm.astype("<f4", copy=False).tobytes(),
    )
    return bytes(message.SerializeToString())


def cloud(touched: ObjectCloud, sensor_id: str, wall_ns: int) -> bytes:
    """The message of a cloud: points in m, each with the number of its object."""
    points = np.empty(len(touched.labels), _POINT)
    points["xyz"], points["object"] = touched.points_mm * np.float32(M_PER_MM), touched.labels
    fields = [
        PackedElementField(name=axis, offset=4 * i, type=PackedElementField.FLOAT32) for i, axis in enumerate("xyz")
    ]
    message = PointCloud(
        timestamp=_timestamp(wall_ns),
        frame_id=_frame_id(sensor_id, "sensor"),
        pose=Pose(position=Vector3(), orientation=Quaternion(w=1.0)),
        point_stride=_POINT.itemsize,
        fields=[*fields, PackedElementField(name="object", offset=12, type=PackedElementField.UINT16)],
        data=points.tobytes(),
    )
    return bytes(message.SerializeToString())


def transform(a_T_b: Sequence[float], parent: Frame, child: Frame, sensor_id: str, wall_ns: int) -> bytes:
    """The message of `child`'s pose in `parent`; `a_T_b` is x, y, z in mm and the quaternion w, x, y, z."""
    x, y, z, qw, qx, qy, qz = a_T_b
    one = FrameTransform(
        timestamp=_timestamp(wall_ns),
        parent_frame_id=_frame_id(sensor_id, parent),
        child_frame_id=_frame_id(sensor_id, child),
        translation=Vector3(x=x * M_PER_MM, y=y * M_PER_MM, z=z * M_PER_MM),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
    return bytes(FrameTransforms(transforms=[one]).SerializeToString())


def log(name: str, text: str, wall_ns: int) -> bytes:
    """The message of a line in a viewer's log."""
    message = Log(timestamp=_timestamp(wall_ns), level=Log.INFO, message=text, name=name)
    return bytes(message.SerializeToString())


def _frame_id(sensor_id: str, frame: Frame) -> str:
    return f"{sensor_id}/{frame}"


def _timestamp(wall_ns: int) -> Timestamp:
    seconds, nanos = divmod(wall_ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)
