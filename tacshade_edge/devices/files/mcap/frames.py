"""The frames of a recording in MCAP: ours, with their times and poses, or the images of somebody else."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from mcap.records import Attachment, Channel, Message, Schema

from tacshade_edge.devices.files.frame_table import ERROR_US_MAX, T_NS_MAX, UNIT_TOLERANCE, Row
from tacshade_edge.devices.files.mcap.images import DECODERS, image_of
from tacshade_edge.devices.files.mcap.records import Damage, ends_whole, records_of, summary_of, times_of
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.quoting import shown
from tacshade_edge.types import U8, Pose

OURS: Final = "tacshade"
"""Key in a channel's metadata, with `CAMERA` or `FRAME`; the channel of frames has their times and poses."""
CAMERA, FRAME = "camera", "frame"
POSE_KEYS: Final = ("x_mm", "y_mm", "z_mm", "qw", "qx", "qy", "qz")
Picture = Callable[[], U8]


class McapFrames:
    """The images of a recording.

    Parameters
    ----------
    paths : sequence of Path
        Its files in order, one at least.

    Attributes
    ----------
    cut_off : bool
        Its writer did not end it: what is whole is here.
    topic : str
        Of the images.

    Raises
    ------
    ConfigError
        No MCAP file; not exactly one topic of images that can be read.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        whole = [ends_whole(path) for path in paths]
        self.cut_off = not all(whole)
        self.topic = _topic_of(paths[0])

    @property
    def length_ns(self) -> int:
        """From the first message to the last, of whichever topic; 0 where a file was cut off, and so does not tell."""
        spans = [times_of(path) for path in self._paths]
        told = [span for span in spans if span is not None]
        return told[-1][1] - told[0][0] if len(told) == len(spans) else 0

    def __iter__(self) -> Iterator[tuple[Row, Picture, int]]:
        """Every frame, its picture, which raises DecodeError where it cannot be used, and the time of its message."""
        last_ns = -1
        for count, (path, schema, encoding, message, about) in enumerate(self._messages()):
            if isinstance(message, Damage):
                yield Row(str(count), max(last_ns, 0), None), _raises(message.error), 0
                continue
            row, where = _row(count, message, about), f"{shown(path)}: message {count} of {self.topic}"
            if row.t_ns > last_ns:
                picture = _picture(where, schema, encoding, message.data)
                yield row, picture, message.log_time
                last_ns = row.t_ns
            else:
                found = f"{where}: found the time {row.t_ns}, expected more than {last_ns} ns of the one before"
                yield row, _raises(DecodeError(found)), 0

    def _messages(self) -> Iterator[tuple[Path, str, str, Message | Damage, dict[str, Any]]]:
        """Those with images, each with its schema, its encoding, and what our channel of frames said before it."""
        for path in self._paths:
            schemas: dict[int, str] = {}
            channels: dict[int, Channel] = {}
            about: dict[str, Any] = {}
            for record in records_of(path):
                match record:
                    case Schema():
                        schemas[record.id] = record.name
                    case Channel():
                        channels[record.id] = record
                    case Damage():
                        yield path, "", "", record, {}
                    case Message() if (channel := channels.get(record.channel_id)) is not None:
                        if channel.metadata.get(OURS) == FRAME:
                            about = _object(record.data)
                        elif channel.topic == self.topic:
                            yield path, schemas.get(channel.schema_id, ""), channel.message_encoding, record, about


def _picture(where: str, schema: str, encoding: str, payload: bytes) -> Picture:
    def picture() -> U8:
        try:
            return image_of(schema, encoding, payload)
        except DecodeError as error:
            raise DecodeError(f"{where}: {error}") from None

    return picture


def attachments_of(path: Path) -> dict[str, bytes]:
    """The files in an MCAP file by name; of those with one name the last. Raises ConfigError."""
    ends_whole(path)
    return {record.name: record.data for record in records_of(path) if isinstance(record, Attachment)}


def _topic_of(path: Path) -> str:
    """Ours, or the only one with images."""
    topics: set[str] = set()
    for channel, schema in _channels_of(path):
        if channel.metadata.get(OURS) == CAMERA:
            return str(channel.topic)
        if (schema.name, channel.message_encoding) in DECODERS:
            topics.add(channel.topic)
    if len(topics) == 1:
        return topics.pop()
    found = f"{len(topics)} topics of images ({', '.join(sorted(topics))})" if topics else "no topic of images"
    expected = ", ".join(f"{schema} in {encoding}" for schema, encoding in DECODERS)
    raise ConfigError(f"{shown(path)}: found {found}, expected one: {expected}")


def _channels_of(path: Path) -> Iterator[tuple[Channel, Schema]]:
    """From the summary, or from the whole of a file without one."""
    schemas: dict[int, Schema] = {}
    for record in summary_of(path) or records_of(path):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.schema_id in schemas:
            yield record, schemas[record.schema_id]


def _row(count: int, message: Message, about: dict[str, Any]) -> Row:
    """By what our channel of frames says of this one, else by the time of the message."""
    if about.get("seq") != message.sequence or not _is_time(about.get("t_ns")):
        return Row(str(count), min(message.log_time, T_NS_MAX), None)
    name, t_ns, error_us = str(about.get("image", count)), about["t_ns"], about.get("pose_error_us")
    pose = [about.get(key) for key in POSE_KEYS]
    if not all(isinstance(value, float | int) and math.isfinite(value) for value in pose):
        return Row(name, t_ns, None)
    values = [float(value) for value in pose if value is not None]
    if abs(math.hypot(*values[3:]) - 1) > UNIT_TOLERANCE:
        return Row(name, t_ns, None)
    known_us = error_us if isinstance(error_us, int) and 0 <= error_us <= ERROR_US_MAX else 0
    return Row(name, t_ns, Pose(t_ns, *values), known_us)


def _is_time(value: object) -> bool:
    return isinstance(value, int) and 0 <= value <= T_NS_MAX


def _object(payload: bytes) -> dict[str, Any]:
    try:
        found = json.loads(payload)
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def _raises(error: DecodeError) -> Picture:
    def picture() -> U8:
        raise error

    return picture
