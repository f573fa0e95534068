"""Images of other programs in MCAP: their order, times, topics and encodings."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from support.recordings import read_all

pytest.importorskip("mcap")
pytest.importorskip("foxglove_schemas_protobuf")
pytest.importorskip("rosbags")
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from mcap.writer import Writer

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.recording.mcap.image_messages import KINDS, image_of
from tacshade_edge.recording.recording import RecordedFrame, Recording

T_NS, PERIOD_NS = 1_795_000_000_000_000_000, 33_333_333
COLOURS = cv2.GaussianBlur(
    np.random.default_rng(2).integers(0, 256, (48, 64, 3), dtype=np.uint8), (0, 0), 6
)
COMPRESSED = [key for key in KINDS if "Compressed" in key[0]]


def png(level: int) -> bytes:
    return cv2.imencode(".png", np.full((4, 4), level, np.uint8))[1].tobytes()


def compressed(kind: tuple[str, str], t_ns: int, data: bytes) -> bytes:
    seconds, nanoseconds = divmod(t_ns, 1_000_000_000)
    if kind[1] == "protobuf":
        message = CompressedImage(data=data, format="png")
        message.timestamp.seconds, message.timestamp.nanos = seconds, nanoseconds
        return bytes(message.SerializeToString())
    texts = b"".join(struct.pack("<I4s", 4, text) for text in (b"cam\0", b"png\0"))
    body = struct.pack("<II", seconds, nanoseconds) + texts + struct.pack("<I", len(data)) + data
    if kind[1] == "cdr":
        return b"\0\1\0\0" + body
    # ROS 1 counts messages, and ends no text with a zero.
    texts = b"".join(struct.pack("<I3s", 3, text) for text in (b"cam", b"png"))
    body = struct.pack("<III", 0, seconds, nanoseconds) + texts
    return body + struct.pack("<I", len(data)) + data


def bag(
    path: Path,
    kind: tuple[str, str],
    stamps_ns: Sequence[int],
    logged_ns: Sequence[int],
    topics: Sequence[str] = ("/cam",),
) -> Path:
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema(kind[0], "any", b"")
        channels = [writer.register_channel(topic, kind[1], schema) for topic in topics]
        for k, (t_ns, log_ns) in enumerate(zip(stamps_ns, logged_ns, strict=True)):
            data = compressed(kind, t_ns, png(k))
            writer.add_message(channels[k % len(channels)], log_ns, data, log_ns)
        writer.finish()
    return path


def levels(frames: list[RecordedFrame]) -> list[int]:
    return [int(recorded.frame.image[0, 0]) for recorded in frames]


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bags") / "a.mcap"


offsets = st.lists(st.integers(0, 5), min_size=1, max_size=20)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(COMPRESSED), offsets, st.data())
def test_frames_come_by_their_own_times_whatever_the_recorder_logged(
    path: Path, kind: tuple[str, str], taken: list[int], data: st.DataObject
) -> None:
    stamps = [T_NS + k * PERIOD_NS for k in taken]
    logged = data.draw(st.sampled_from([stamps, [T_NS] * len(taken), list(range(len(taken)))]))
    frames, refused = read_all(Recording(bag(path, kind, stamps, logged)))
    assert refused == []
    assert [recorded.frame.t_ns for recorded in frames] == sorted(stamps)
    assert [recorded.wall_ns for recorded in frames] == sorted(stamps)
    order = sorted(range(len(taken)), key=lambda k: (stamps[k], k))  # equal times are kept
    assert levels(frames) == order


@pytest.mark.parametrize("kind", COMPRESSED)
def test_without_a_stamp_the_log_time_counts(path: Path, kind: tuple[str, str]) -> None:
    frames, _ = read_all(Recording(bag(path, kind, [0, 0, 0], [7, 5, 9])))
    assert [recorded.frame.t_ns for recorded in frames] == [5, 7, 9]
    frames, refused = read_all(Recording(bag(path, kind, [5, 0, 9], [7, 5, 9])))
    assert len(frames) == 2
    assert refused == [
        f"{path}: message 1 of /cam: found no time in its header, expected one as in the first "
        "message"
    ]


def test_what_is_far_out_of_order_is_named(path: Path) -> None:
    stamps = [T_NS + k for k in range(1, 101)] + [T_NS]
    frames, refused = read_all(Recording(bag(path, COMPRESSED[0], stamps, stamps)))
    assert len(frames) == 100
    assert "message 100 of /cam: found the time" in refused[0]


def test_one_of_several_topics_is_chosen(path: Path) -> None:
    topics = ("/tactile/image", "/wrist/image")
    bag(path, COMPRESSED[0], range(1, 7), range(1, 7), topics)
    with pytest.raises(ConfigError, match=r"found 2 image topics .* chosen with --topic"):
        Recording(path)
    for first, topic in enumerate(topics):
        assert levels(read_all(Recording(path, topic=topic))[0]) == list(range(first, 6, 2))
    with pytest.raises(
        ConfigError, match=r"--topic: found /x, expected one of /tactile/image, /wrist/image"
    ):
        Recording(path, topic="/x")
    with pytest.raises(ConfigError, match=r"--topic: found /x, expected none: .* is not MCAP"):
        Recording(path.parent / "a.png", topic="/x")


def raw(encoding: str, pixels: np.ndarray, width_px: int) -> bytes:
    rows, step = pixels.shape[0], pixels[0].nbytes
    message = RawImage(
        width=width_px, height=rows, encoding=encoding, step=step, data=pixels.tobytes()
    )
    return bytes(message.SerializeToString())


def decoded(encoding: str, pixels: np.ndarray, width_px: int = 64) -> np.ndarray:
    return image_of("foxglove.RawImage", "protobuf", raw(encoding, pixels, width_px))


@pytest.mark.parametrize(
    ("encoding", "first", "second"),
    [("rggb", "rg", "gb"), ("bggr", "bg", "gr"), ("gbrg", "gb", "rg"), ("grbg", "gr", "bg")],
)
def test_bayer_patterns(encoding: str, first: str, second: str) -> None:
    mosaic = np.zeros((48, 64), np.uint8)
    for row, names in enumerate((first, second)):
        for col, name in enumerate(names):
            mosaic[row::2, col::2] = COLOURS[row::2, col::2, "bgr".index(name)]
    found = decoded(f"bayer_{encoding}8", mosaic)
    np.testing.assert_allclose(found[2:-2, 2:-2], COLOURS[2:-2, 2:-2].astype(int), atol=6)


@pytest.mark.parametrize(("encoding", "luma_at"), [("yuv422_yuy2", 0), ("yuv422", 1)])
def test_two_pixels_with_one_colour(encoding: str, luma_at: int) -> None:
    yuv = cv2.cvtColor(COLOURS, cv2.COLOR_BGR2YUV).astype(int)
    # Of video: 16 to 235.
    luma = 16 + yuv[..., 0] * 219 // 255
    pairs = np.full((48, 64, 2), 128, np.uint8)
    pairs[..., luma_at] = luma
    grey = decoded(encoding, pairs.reshape(48, 128))
    np.testing.assert_allclose(grey, yuv[..., :1] + np.zeros(3, int), atol=3)
    with pytest.raises(DecodeError, match=r"found 63 columns of .*, expected an even number"):
        decoded(encoding, pairs.reshape(48, 128), 63)


def test_sixteen_bits_become_eight() -> None:
    deep = (COLOURS[..., 0].astype("<u2") << 8) + 200
    np.testing.assert_array_equal(decoded("mono16", deep), COLOURS[..., 0])


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("a.bag", b"#ROSBAG V2.0\n", "found a bag of ROS 1, expected MCAP; to convert it: "),
        ("a.db3", b"SQLite format 3\0", "found a bag of ROS 2 in SQLite, expected MCAP; to "),
    ],
)
def test_another_bag_is_named_with_its_converter(
    tmp_path: Path, name: str, data: bytes, says: str
) -> None:
    (tmp_path / name).write_bytes(data)
    for given_path in (tmp_path / name, tmp_path):
        with pytest.raises(ConfigError, match=says) as refusal:
            Recording(given_path)
        assert "rosbags-convert --src" in str(refusal.value)
        assert str(refusal.value).endswith("--dst a --dst-storage mcap")
