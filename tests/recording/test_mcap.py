from __future__ import annotations

import io
import json
import random
import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.recordings import read_all

pytest.importorskip("mcap")
pytest.importorskip("foxglove_schemas_protobuf")
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from support.mcap_bytes import CHUNK, DATA_END, described, file_of, flipped, message, record_starts
from tacshade_edge.errors import ConfigError
from tacshade_edge.recording.mcap import ros_image, stored_frames
from tacshade_edge.recording.mcap.writer import McapWriter, camera_message
from tacshade_edge.recording.recorder import png_of
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.recording_content import content_of, events_in
from tacshade_edge.types import U8, Frame, Pose

EARLIER = Path(__file__).parents[1] / "golden" / "recorded-mcap"
PERIOD_NS = 16_666_667
WALL_NS = 1_790_000_000_000_000_000


def picture(seq: int) -> U8:
    return np.random.default_rng(seq).integers(0, 256, (120, 160), dtype=np.uint8)


def frame(seq: int) -> Frame:
    t_ns = 500 + seq * PERIOD_NS
    pose = Pose(t_ns, 0.1 * seq, 2.5, -3.0, 0.6, 0.0, -0.8, 0.0) if seq % 2 else None
    return Frame(seq, t_ns, WALL_NS + t_ns, picture(seq), pose, 412 if pose else 0)


def ours(frames: int) -> bytes:
    """Each picture ends a chunk."""
    stream = io.BytesIO()
    writer = McapWriter(stream, "left", chunk_bytes=1 << 14)
    writer.attach("calibration.npz", b"12", 0)
    for seq in range(frames):
        writer.frame(f"{seq:06d}.png", frame(seq), png_of(picture(seq)), WALL_NS + frame(seq).t_ns)
    writer.finish()
    return stream.getvalue()


def seqs(path: Path) -> list[int]:
    frames, refused = read_all(Recording(path))
    assert refused == []
    for recorded in frames:
        was = frame(int(recorded.name[:6]))
        np.testing.assert_array_equal(recorded.frame.image, was.image)
        assert (recorded.frame.t_ns, recorded.frame.pose, recorded.wall_ns) == (
            was.t_ns,
            was.pose,
            was.wall_ns,
        )
    return [int(recorded.name[:6]) for recorded in frames]


def test_a_recording_that_an_earlier_daemon_made_in_mcap(tmp_path: Path) -> None:
    """Its process ended in the second of its files."""
    folder = tmp_path / "rec"
    shutil.copytree(EARLIER, folder)
    frames, refused = read_all(Recording(folder))
    assert refused == []
    assert [recorded.name for recorded in frames] == [f"{seq:06d}.png" for seq in range(6)]
    for seq, recorded in enumerate(frames):
        was = frame(seq)
        assert (recorded.frame.t_ns, recorded.frame.pose, recorded.wall_ns) == (
            was.t_ns,
            was.pose,
            was.wall_ns,
        )
        assert recorded.frame.image[3, 5] == 7
        assert recorded.frame.image[0, 0] == 40 * seq
    assert Recording(folder).cut_off
    assert [event.kind for event in events_in(content_of(folder))] == ["start"]
    assert content_of(folder / "000.mcap")["calibration.npz"] == b"a calibration"


def test_a_standard_reader_opens_what_is_written(tmp_path: Path) -> None:
    with _written(tmp_path, ours(5)).open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert {found.name for found in reader.iter_attachments()} == {"calibration.npz"}
        assert (summary := reader.get_summary()) is not None
        assert len(summary.chunk_indexes) >= 5
        assert [channel.topic for _, channel, _ in reader.iter_messages()].count(
            "/tacshade/left/camera"
        ) == 5


def test_after_a_cut_at_any_byte_the_frames_before_are_read(tmp_path: Path) -> None:
    whole = ours(30)  # half a second
    part = tmp_path / "000.mcap.part"
    data_end = next(at for at in record_starts(whole) if whole[at] == DATA_END)
    for after in (b"", bytes(70_000)):  # blocks that a power cut left empty
        part.write_bytes(whole[:data_end] + after)
        assert seqs(part) == list(range(30))
    draw = random.Random(3)
    for at in (draw.randrange(len(whole) // 8, data_end) for _ in range(8)):
        part.write_bytes(whole[:at])
        found = seqs(part)
        assert found == list(range(len(found)))
        assert len(found) >= 30 * at // len(whole) - 2


def test_a_loop_goes_on_in_time_and_a_file_states_its_length_unless_it_was_cut_off(
    tmp_path: Path,
) -> None:
    path = tmp_path / "rec.mcap"
    path.write_bytes(ours(5))
    assert Recording(path).length_ns == 4 * PERIOD_NS
    recording = Recording(path, times=2)
    times = [recorded.frame.t_ns for _ in range(10) if (recorded := recording.read()) is not None]
    assert np.diff(times).tolist() == [PERIOD_NS] * 9
    with pytest.raises(ConfigError, match="contains the time stamps"):
        Recording(path, fps=30)
    path.write_bytes(ours(5)[:-20])
    assert (Recording(path).length_ns, Recording(path).cut_off) == (0, True)


@pytest.mark.slow
def test_one_flipped_bit_costs_a_chunk_at_most_and_is_reported(tmp_path: Path) -> None:
    whole = ours(4)
    good = {
        recorded.name: recorded for recorded in read_all(Recording(_written(tmp_path, whole)))[0]
    }
    assert len(good) == 4
    heads = [begin + byte for begin in record_starts(whole) for byte in range(9)]
    draw = random.Random(5)
    # All of a record's head, for every kind; some of the rest.
    for at in (*draw.sample(heads, 60), *(draw.randrange(len(whole)) for _ in range(40))):
        path = _written(tmp_path, flipped(whole, at, draw.randrange(8)))
        frames, refused = read_all(Recording(path))
        for recorded in frames:
            was, found = good[recorded.name].frame, recorded.frame
            assert (found.t_ns, found.pose) == (was.t_ns, was.pose)
            np.testing.assert_array_equal(found.image, was.image)
        assert len(frames) >= 3
        assert len(frames) == 4 or refused


def test_without_an_index_damage_costs_its_chunk_or_what_follows_its_head(tmp_path: Path) -> None:
    whole = ours(5)
    chunks = [begin for begin in record_starts(whole) if whole[begin] == CHUNK]
    path = tmp_path / "rec.mcap.part"
    torn = whole[: chunks[-1] + 100]
    path.write_bytes(flipped(torn, chunks[2] + 1000, 3))
    frames, refused = read_all(Recording(path))
    # The last chunk is torn, as in a recording that still goes on.
    assert len(frames) == len(chunks) - 2
    assert len(refused) == 1
    assert "skipping the damaged chunk" in refused[0]
    for byte in (1, 4, 8):
        path.write_bytes(flipped(torn, chunks[2] + byte, 7))
        frames, refused = read_all(Recording(path))
        assert [recorded.name for recorded in frames] == ["000000.png", "000001.png"]
        assert Recording(path).cut_off


@pytest.mark.parametrize("number", ["1" + "0" * 400, "1e308", "NaN", "{}"])
@pytest.mark.parametrize("key", ["x_mm", "qw", "t_ns", "pose_error_us", "image"])
def test_what_is_said_of_a_frame_is_bounded_before_it_is_used(
    tmp_path: Path, key: str, number: str
) -> None:
    about = {
        "image": "1.png",
        "seq": 1,
        "t_ns": 90,
        "x_mm": 1.0,
        "y_mm": 2.0,
        "z_mm": 3.0,
        "qw": 1.0,
    }
    about |= {"qx": 0.0, "qy": 0.0, "qz": 0.0, "pose_error_us": 0}
    stream = io.BytesIO()
    writer = McapWriter(stream, "left")
    for seq in range(3):
        text = json.dumps({**about, "seq": seq, "t_ns": 90 + seq})
        if seq == 1:
            text = json.dumps({**about, key: "HERE"}).replace('"HERE"', number)
        writer.write("frame", text.encode(), 90 + seq, seq)
        writer.write("camera", camera_message(png_of(picture(seq)), "left", 0), 0, seq)
    writer.finish()
    frames, refused = read_all(Recording(_written(tmp_path, stream.getvalue())))
    assert [recorded.frame.t_ns for recorded in frames] == [90, 92]
    assert len(refused) == 1
    assert "message 1 of /tacshade/left/camera: " in refused[0]
    assert len(refused[0]) < 500


def test_a_unix_time_of_64_bits_is_refused(tmp_path: Path) -> None:
    stream = io.BytesIO()
    writer = McapWriter(stream, "left")
    for seq, wall_ns in enumerate((WALL_NS, 2**64 - 1, WALL_NS + 1)):
        writer.frame(f"{seq}.png", frame(seq), png_of(picture(seq)), wall_ns)
    writer.finish()
    frames, refused = read_all(Recording(_written(tmp_path, stream.getvalue())))
    assert [recorded.wall_ns for recorded in frames] == [WALL_NS, WALL_NS + 1]
    assert [line.rpartition(": ")[2] for line in refused] == [
        "found the time 18446744073709551615, expected at most 2^62 ns"
    ]


def test_a_file_of_several_that_is_none_is_reported_and_the_others_are_read(tmp_path: Path) -> None:
    (tmp_path / "000.mcap").write_bytes(ours(3))
    (tmp_path / "001.mcap.part").write_bytes(b"")
    recording = Recording(tmp_path)
    assert "001.mcap.part: not an MCAP file; leaving its frames out" in recording.damage
    assert len(read_all(Recording(tmp_path))[0]) == 3
    # Its writer has ended it meanwhile.
    assert len(read_all(Recording(tmp_path / "000.mcap.part"))[0]) == 3


def _written(folder: Path, content: bytes) -> Path:
    path = folder / "rec.mcap"
    path.write_bytes(content)
    return path


RGB = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
OTHERS = {
    "foxglove.RawImage": RawImage(
        width=64, height=48, encoding="rgb8", step=192, data=RGB.tobytes()
    ),
    "foxglove.CompressedImage": CompressedImage(
        data=cv2.imencode(".png", RGB[:, :, ::-1])[1].tobytes(), format="png"
    ),
}


@pytest.mark.parametrize("schema", OTHERS)
@pytest.mark.parametrize("compression", list(CompressionType))
def test_images_of_others(tmp_path: Path, schema: str, compression: CompressionType) -> None:
    path = tmp_path / "rec.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression)
        writer.start()
        channel = writer.register_channel(
            "/cam", "protobuf", writer.register_schema(schema, "protobuf", b"")
        )
        for t_ns in (5, 9, 7):
            writer.add_message(channel, t_ns, OTHERS[schema].SerializeToString(), t_ns)
        writer.finish()
    frames, refused = read_all(Recording(path))
    assert [(recorded.frame.t_ns, recorded.wall_ns) for recorded in frames] == [
        (5, 5),
        (7, 7),
        (9, 9),
    ]
    np.testing.assert_array_equal(frames[0].frame.image, RGB[:, :, ::-1])
    assert refused == []


def test_a_bag_of_ros_2(tmp_path: Path) -> None:
    ros2 = pytest.importorskip("mcap_ros2.writer")
    text = (
        "std_msgs/Header header\n"
        "uint32 height\n"
        "uint32 width\n"
        "string encoding\n"
        "uint8 is_bigendian\n"
        "uint32 step\n"
        "uint8[] data\n"
        f"{'=' * 80}\n"
        "MSG: std_msgs/Header\n"
        "builtin_interfaces/Time stamp\n"
        "string frame_id\n"
        f"{'=' * 80}\n"
        "MSG: builtin_interfaces/Time\n"
        "int32 sec\n"
        "uint32 nanosec\n"
    )
    header = {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "finger"}
    image = {
        "header": header,
        "height": 48,
        "width": 64,
        "encoding": "mono8",
        "is_bigendian": 0,
        "step": 64,
    }
    path = tmp_path / "bag_0.mcap"
    with path.open("wb") as stream:
        writer = ros2.Writer(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/Image", text)
        writer.write_message("/cam", schema, {**image, "data": RGB[:, :, 0].tobytes()}, log_time=11)
        writer.finish()
    frames, refused = read_all(Recording(path))
    assert refused == []
    np.testing.assert_array_equal(frames[0].frame.image, RGB[:, :, 0])


def test_without_rosbags_an_image_of_ros_2_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ros_image.typestore.cache_clear()
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    with pytest.raises(ConfigError, match=r"found no package rosbags.*to install it: pip install"):
        stored_frames.image_of("sensor_msgs/msg/Image", "cdr", b"")


def test_what_has_no_one_topic_of_images_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    for topics, found in (([], "no image topics"), (["/a", "/b"], "2 image topics (/a, /b)")):
        with path.open("wb") as stream:
            writer = Writer(stream)
            writer.start()
            schema = writer.register_schema("foxglove.RawImage", "protobuf", b"")
            for topic in topics:
                writer.register_channel(topic, "protobuf", schema)
            writer.finish()
        with pytest.raises(ConfigError, match="expected one") as error:
            Recording(path)
        assert found in str(error.value)
    whole = ours(3)
    chunk = next(at for at in record_starts(whole) if whole[at] == CHUNK)
    for end in (9, chunk, chunk + 5, chunk + 100):  # cut before, at and in the first chunk
        path.write_bytes(whole[:end])
        with pytest.raises(ConfigError, match=r"no image topics.*was cut off"):
            Recording(path)
    for content in (b"", b"\x89PNG\r\n\x1a\n"):
        path.write_bytes(content)
        with pytest.raises(ConfigError, match="not an MCAP file"):
            Recording(path)
    with pytest.raises(ConfigError, match="No such file"):
        Recording(tmp_path / "none.mcap")


def test_what_is_reported_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_frames, "_UNUSABLE_MAX", 10)
    inside = described() + message(b"no image", 5) + message(b"", 6) * 100
    read, refused = read_all(Recording(_written(tmp_path, file_of(inside))))
    assert read == []
    assert len(refused) == 12
    assert refused[-1] == "/cam: found 11 unusable messages; skipping all later messages"


@pytest.mark.parametrize(
    ("message", "found"),
    [
        (
            RawImage(width=64, height=48, encoding="32FC1", step=256, data=b"1234"),
            "the encoding '32FC1'",
        ),
        (RawImage(width=64, height=48, encoding="mono8", step=64, data=b"1234"), "found 4 bytes"),
        (
            RawImage(width=1 << 30, height=1 << 30, encoding="mono8", step=1 << 30),
            "expected at most",
        ),
        (
            RawImage(width=64, height=48, encoding="mono8", step=3, data=bytes(48 * 64)),
            "expected 48 rows of 3 bytes",
        ),
    ],
)
def test_an_image_that_is_none_is_reported(tmp_path: Path, message: RawImage, found: str) -> None:
    path = tmp_path / "rec.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("foxglove.RawImage", "protobuf", b"")
        channel = writer.register_channel("/cam", "protobuf", schema)
        writer.add_message(channel, 1, message.SerializeToString(), 1)
        writer.add_message(channel, 2, b"\xff\xff\xff", 2)
        writer.finish()
    frames, refused = read_all(Recording(path))
    assert frames == []
    assert found in refused[0]
    assert len(refused) == 2
