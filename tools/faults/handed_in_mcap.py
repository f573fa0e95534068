"""MCAP inputs to damage: files from our recorder, and files of others that expand enormously."""

from __future__ import annotations

import io
import json
import logging
import random
import struct
import zlib
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import lz4.frame
import zstandard

from tacshade_edge.errors import DecodeError
from tacshade_edge.storage.recording.mcap import messages
from tacshade_edge.storage.recording.mcap.writer import McapWriter
from tacshade_edge.storage.recording.mcap_recorder import McapRecorder
from tacshade_edge.storage.recording.recorder import png_of
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.recording.recording_content import content_of, events_in
from tacshade_edge.types import Frame, Pose
from tools.faults.handed_in import Files, Junk, Kind, bytes_of
from tools.testbed.mcap_bytes import CHUNK, chunk, described, file_of, flipped, message, record, record_starts
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration

_log = logging.getLogger("tacshade_edge.faults")
_NAME = "a.mcap"
_KEYS = ("image", "seq", "t_ns", "x_mm", "qw", "pose_error_us")
_NUMBERS = ("1" + "0" * 400, "1e308", "-1e308", "1e999", "NaN", "9" * 5000, "[" * 5000)
_BLOCK_BYTES = 1 << 20
_BLOCKS = (1, 16, 64, 250)
_ATTACHMENT = 9


def mcap_kinds() -> dict[str, Kind]:
    """Make the kinds: our recording, complete and cut off, with bombs and odd numbers behind right checksums."""
    with TemporaryDirectory() as folder:
        whole, cut_off = _recorded(Path(folder) / "rec")
    own = Kind({_NAME: whole}, (_NAME,), partial(_read, _NAME), checked=True, sealed=partial(_sealed, whole))
    name = f"{_NAME}.part"
    return {"MCAP": own, "MCAP cut off": Kind({name: cut_off}, (name,), partial(_read, name), checked=True)}


def _recorded(folder: Path) -> tuple[bytes, bytes]:
    recorder = McapRecorder(folder, "left", free_floor_bytes=0)
    recorder.begin("sensor_id: left\n", painted_calibration())
    for k, image in enumerate((FREE, TOUCHED) * 3):
        pose = Pose(1000 + 7 * k, 0.1, -3.0, 1.0, 0.6, 0.0, -0.8, 0.0) if k % 2 else None
        recorder.add(Frame(k, 1000 + 7 * k, 5_000 + 7 * k, image, pose, 4 if pose else 0), png_of(image))
    cut_off = (folder / "000.mcap.part").read_bytes()
    recorder.finish({"frames": 6})
    return (folder / "000.mcap").read_bytes(), cut_off


def _read(name: str, folder: Path) -> Any:
    """Read a recording as `replay` and `export` do, whose lines become warnings here."""
    recording, read = Recording(folder / name), []
    for line in (recording.damage, "it was cut off" if recording.cut_off and not name.endswith(".part") else ""):
        if line:
            _log.warning("%s", line)
    while True:
        try:
            if (recorded := recording.read()) is None:
                break
        except DecodeError as error:
            _log.warning("frame passed over: %s", error)
            continue
        frame = recorded.frame
        read.append((frame.t_ns, bytes_of(frame.image), frame.pose, recorded.wall_ns))
    content = content_of(folder / name)
    events = [event.t_ns for event in events_in(content)]
    return read, sorted((key, zlib.crc32(data)) for key, data in content.items()), events, recording.length_ns


def _sealed(whole: bytes, draw: random.Random, junk: Junk) -> Files:
    way = draw.choice((_told_otherwise, _packed, _packed, _inner_length, _inner_length))
    return {_NAME: way(whole, draw, junk)}


def _told_otherwise(_whole: bytes, draw: random.Random, junk: Junk) -> bytes:
    """Make a recording whose frame channel contains a wrong value for one picture."""
    stream = io.BytesIO()
    writer = McapWriter(stream, "left", chunk_bytes=1 << 12)
    for seq in range(3):
        about = {"image": "a", "seq": seq, "t_ns": 90 + seq, **dict.fromkeys(("x_mm", "y_mm", "z_mm"), 1.0)}
        about |= {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "pose_error_us": 0}
        text = json.dumps(about)
        if seq == 1:
            value = draw.choice(_NUMBERS) if draw.random() < 0.5 else json.dumps(junk(draw))
            text = json.dumps({**about, draw.choice(_KEYS): "HERE"}).replace('"HERE"', value)
        writer.write("frame", text.encode(), 90 + seq, seq)
        writer.write("camera", messages.camera(png_of(FREE), "left", 0), 0, seq)
    writer.finish()
    return stream.getvalue()


def _packed(_whole: bytes, draw: random.Random, _junk: Junk) -> bytes:
    """Pack up to 250 MiB of messages, or one such message, into a few kB of data (up to 40 times) or summary."""
    one = draw.choice((message(b"", 5), message(b"", 5), message(bytes(1000), 5)))
    block = one * (_BLOCK_BYTES // len(one))
    blocks = draw.choice(_BLOCKS)
    size = blocks * len(block)
    if draw.random() < 0.3:
        head = record(5, bytes(size - 9))[:40]
        block, head = bytes(len(block)), head + bytes(len(block) - len(head))
    else:
        head = block
    name = draw.choice(("zstd", "lz4"))
    packing: Any = zstandard.ZstdCompressor().compressobj() if name == "zstd" else lz4.frame.LZ4FrameCompressor()
    crc, parts = 0, [] if name == "zstd" else [packing.begin()]
    for k in range(blocks):
        piece = block if k else head
        parts.append(packing.compress(piece))
        crc = zlib.crc32(piece, crc)
    packed = b"".join((*parts, packing.flush()))
    if draw.random() < 0.3:
        size = draw.choice((size - 1, size + 1, 1, 0, 2**31, 2**63, 32 << 20))
    bomb = chunk(packed, name, size, draw.choice((crc, crc, 0)))
    if draw.random() < 0.3:
        return file_of(described() + message(b"a", 7), bomb)
    return file_of(described() + bomb * draw.choice((1, 1, 3, 40) if len(bomb) < 100_000 else (1, 3)))


def _inner_length(whole: bytes, draw: random.Random, _junk: Junk) -> bytes:
    """Flip one bit of a length inside a record, or of the summary's position."""
    starts = record_starts(whole)
    at = draw.choice([start for start in starts if whole[start] in (CHUNK, _ATTACHMENT)])
    body, bit = at + 9, draw.choice((draw.randrange(33, 64), draw.randrange(64)))
    if draw.random() < 0.2:
        field = starts[-1] + 9
    elif whole[at] == CHUNK:
        field = draw.choice((body + 16, body + 32))
    else:
        name_end = body + 20 + struct.unpack_from("<I", whole, body + 16)[0]
        field = name_end + 4 + struct.unpack_from("<I", whole, name_end)[0]
    return flipped(whole, field + bit // 8, bit % 8)
