"""Writes our channels to an MCAP file, in Foxglove's schemas (protobuf) and flat JSON.

Foxglove's lengths and positions are in metres, times in Unix time, as viewers expect. Values read
only as numbers stay in mm: a pixel of the height image is h in mm. The frames of reference are
``ID/base``, ``ID/flange`` and ``ID/sensor``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, BinaryIO, Final, Literal

import msgspec
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
from google.protobuf.descriptor import FileDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, McapRecord, Schema
from mcap.writer import CompressionType, Writer

from tacshade_edge.recording.mcap.stored_frames import CAMERA, FRAME, OURS, POSE_KEYS, FrameAbout
from tacshade_edge.types import F32, Frame, ObjectCloud
from tacshade_edge.version import installed_version
from tacshade_edge.wire.messages import TOUCH_SCHEMA
from tacshade_edge.wire.sensor_topics import Contact

# What damage costs, at most.
CHUNK_BYTES: Final = 1 << 20
_MEDIA_TYPES: Final = {
    "yaml": "application/yaml",
    "json": "application/json",
    "jsonl": "application/jsonl",
}
_NUMBER: Final = {"type": "number"}
_TEXT: Final = {"type": "string"}
# Any value may be null, which the viewers' JSON Schema cannot express.
_SCHEMAS: Final[dict[str, dict[str, Any]]] = {
    FRAME: dict.fromkeys(FrameAbout.__struct_fields__, _NUMBER) | {"image": _TEXT},
    "contact": {
        field.name: _TEXT if field.name.endswith("_code") else _NUMBER for field in fields(Contact)
    },
    "touch": TOUCH_SCHEMA["properties"],
    "objects": dict.fromkeys(("t_ns", "wall_ns", "seq"), _NUMBER) | {"fingers": {"type": "object"}},
}


class McapWriter:
    """Writes one MCAP file to a buffered stream, with topics ``/tacshade/ID/NAME``; all times are
    the capture's Unix time. Schemas and channels are repeated after each chunk, so that a damaged
    chunk loses only its own messages.
    """

    def __init__(
        self,
        stream: BinaryIO,
        sensor_id: str,
        *,
        chunk_bytes: int = CHUNK_BYTES,
    ) -> None:
        # For maps and clouds: a PNG cannot be compressed further.
        self._writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType.ZSTD)
        self._writer.start(profile="", library=f"tacshade-edge {installed_version()}")
        self._stream, self._sensor_id = stream, sensor_id
        self._channels: dict[str, int] = {}
        self._described = b""
        self._chunk_at = stream.tell()

    def frame(self, name: str, frame: Frame, png: bytes, wall_ns: int) -> None:
        """Write a captured frame: its name, times and pose, then its picture."""
        values = (
            {}
            if (pose := frame.pose) is None
            else {key: float(getattr(pose, key)) for key in POSE_KEYS}
        )
        error_us = frame.pose_error_us if values else None
        about = FrameAbout(
            image=name, seq=frame.seq, t_ns=frame.t_ns, pose_error_us=error_us, **values
        )
        # Before the picture: a reader that meets a picture knows its time.
        self.write(FRAME, msgspec.json.encode(about), wall_ns, frame.seq)
        if values:
            self.write(
                "tf",
                transform_message(
                    tuple(values.values()), "base", "flange", self._sensor_id, wall_ns
                ),
                wall_ns,
            )
        self.write(CAMERA, camera_message(png, self._sensor_id, wall_ns), wall_ns, frame.seq)

    def write(self, name: str, payload: bytes, wall_ns: int, seq: int = 0) -> None:
        """Write a message on the channel `name`."""
        if name not in self._channels:
            self._channels[name] = self._registered(name)
        self._writer.add_message(self._channels[name], wall_ns, payload, wall_ns, seq)
        # The package does not say that it has ended a chunk: the stream has grown.
        if self._stream.tell() > self._chunk_at:
            self._stream.write(self._described)
            self._chunk_at = self._stream.tell()

    def attach(self, name: str, data: bytes, wall_ns: int) -> None:
        """Write a file as an attachment."""
        media_type = _MEDIA_TYPES.get(name.rpartition(".")[2], "application/octet-stream")
        self._writer.add_attachment(wall_ns, wall_ns, name, media_type, data)
        # The stream has grown, but by no chunk.
        self._chunk_at = self._stream.tell()

    def describe(self, name: str, about: Mapping[str, str]) -> None:
        """Write metadata for people or programs."""
        self._writer.add_metadata(name, dict(about))
        self._chunk_at = self._stream.tell()

    def finish(self) -> None:
        """Write the last chunk, and the summary that completes the file."""
        self._writer.finish()

    def _registered(self, name: str) -> int:
        if name in _SCHEMAS:
            title = f"tacshade.{name.capitalize()}"
            schema = {"title": title, "type": "object", "properties": _SCHEMAS[name]}
            return self._channel(name, "json", title, "jsonschema", json.dumps(schema).encode())
        descriptor = MESSAGES[name].DESCRIPTOR
        files: dict[str, FileDescriptor] = {}
        _with_what_it_imports(descriptor.file, files)
        described = FileDescriptorSet()
        for file in files.values():
            file.CopyToProto(described.file.add())
        return self._channel(
            name, "protobuf", descriptor.full_name, "protobuf", described.SerializeToString()
        )

    def _channel(
        self, name: str, encoding: str, title: str, schema_encoding: str, schema: bytes
    ) -> int:
        topic, ours = f"/tacshade/{self._sensor_id}/{name}", {OURS: name}
        schema_id = self._writer.register_schema(title, schema_encoding, schema)
        channel_id = int(self._writer.register_channel(topic, encoding, schema_id, ours))
        self._described += _bytes_of(
            Schema(id=schema_id, data=schema, encoding=schema_encoding, name=title)
        )
        channel = Channel(
            id=channel_id,
            topic=topic,
            message_encoding=encoding,
            metadata=ours,
            schema_id=schema_id,
        )
        self._described += _bytes_of(channel)
        return channel_id


def _bytes_of(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return bytes(builder.end())


def _with_what_it_imports(file: FileDescriptor, found: dict[str, FileDescriptor]) -> None:
    # First what a file imports: readers build the types in this order.
    for other in file.dependencies:
        _with_what_it_imports(other, found)
    found[file.name] = file


M_PER_MM: Final = 0.001
MESSAGES: Final[dict[str, Any]] = {
    "camera": CompressedImage,
    "height": RawImage,
    "cloud": PointCloud,
    "tf": FrameTransforms,
    "log": Log,
}
ReferenceFrame = Literal["base", "flange", "sensor"]
_POINT: Final = np.dtype([("xyz", "<f4", 3), ("object", "<u2")])


def camera_message(png: bytes, sensor_id: str, wall_ns: int) -> bytes:
    """The message of a captured frame, lossless."""
    frame_id = f"{sensor_id}/sensor"
    message = CompressedImage(
        timestamp=_timestamp(wall_ns), frame_id=frame_id, data=png, format="png"
    )
    return bytes(message.SerializeToString())


def height_message(height_mm: F32, sensor_id: str, wall_ns: int) -> bytes:
    """The message of a height map: each cell's h in mm as ``32FC1``; NaN outside the disc."""
    rows, cols = height_mm.shape
    message = RawImage(
        timestamp=_timestamp(wall_ns),
        frame_id=f"{sensor_id}/sensor",
        width=cols,
        height=rows,
        encoding="32FC1",
        step=4 * cols,
        data=height_mm.astype("<f4", copy=False).tobytes(),
    )
    return bytes(message.SerializeToString())


def cloud_message(touched: ObjectCloud, sensor_id: str, wall_ns: int) -> bytes:
    """The message of a cloud: points in m, each with the number of its object."""
    points = np.empty(len(touched.labels), _POINT)
    points["xyz"], points["object"] = touched.points_mm * np.float32(M_PER_MM), touched.labels
    described = [
        PackedElementField(name=axis, offset=4 * i, type=PackedElementField.FLOAT32)
        for i, axis in enumerate("xyz")
    ]
    message = PointCloud(
        timestamp=_timestamp(wall_ns),
        frame_id=f"{sensor_id}/sensor",
        pose=Pose(position=Vector3(), orientation=Quaternion(w=1.0)),
        point_stride=_POINT.itemsize,
        fields=[
            *described,
            PackedElementField(name="object", offset=12, type=PackedElementField.UINT16),
        ],
        data=points.tobytes(),
    )
    return bytes(message.SerializeToString())


def transform_message(
    a_T_b: Sequence[float],
    parent: ReferenceFrame,
    child: ReferenceFrame,
    sensor_id: str,
    wall_ns: int,
) -> bytes:
    """The message of `child`'s pose in `parent`; `a_T_b` is x, y, z in mm and the quaternion w, x,
    y, z.
    """
    x, y, z, qw, qx, qy, qz = a_T_b
    one = FrameTransform(
        timestamp=_timestamp(wall_ns),
        parent_frame_id=f"{sensor_id}/{parent}",
        child_frame_id=f"{sensor_id}/{child}",
        translation=Vector3(x=x * M_PER_MM, y=y * M_PER_MM, z=z * M_PER_MM),
        rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
    )
    return bytes(FrameTransforms(transforms=[one]).SerializeToString())


def log_message(name: str, text: str, wall_ns: int) -> bytes:
    """The message of a line in a viewer's log."""
    message = Log(timestamp=_timestamp(wall_ns), level=Log.INFO, message=text, name=name)
    return bytes(message.SerializeToString())


def _timestamp(wall_ns: int) -> Timestamp:
    seconds, nanos = divmod(wall_ns, 1_000_000_000)
    return Timestamp(seconds=seconds, nanos=nanos)
