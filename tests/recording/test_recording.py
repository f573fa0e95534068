from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.painted_sensor import painted_calibration
from support.recordings import HEADER, write_recording
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.recording.frame_table import read_table
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import RecordedFrame, Recording
from tacshade_edge.recording.recording_content import content_of, events_in, wall_minus_t_ns
from tacshade_edge.types import U8, Frame, Pose


def picture(level: int) -> np.ndarray:
    return np.full((48, 64, 3), level, dtype=np.uint8)


def every(recording: Recording, most: int = 100) -> list[RecordedFrame]:
    frames: list[RecordedFrame] = []
    while len(frames) < most and (recorded := recording.read()) is not None:
        frames.append(recorded)
    return frames


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "rec", [picture(10 * k) for k in range(3)])


def test_it_is_wound_forward_without_reading_what_lies_between(folder: Path) -> None:
    (folder / "000000.png").write_bytes(b"no image")
    recording = Recording(folder)
    assert recording.length_ns == 20_000_000
    recording.skip_to(500 + 20_000_000, frames=1)
    assert [recorded.frame.seq for recorded in every(recording)] == [1, 2]
    recording.skip_to(0)
    assert recording.read() is None


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25, (64, 48))
    assert writer.isOpened()
    for k in range(3):
        writer.write(picture(80 * k))
    writer.release()
    return path


def test_a_table_gives_order_times_and_poses(folder: Path) -> None:
    rows = (folder / "frames.csv").read_text().splitlines()[1:]
    names = [rows[2].split(",")[0], rows[0].split(",")[0]]
    (folder / "frames.csv").write_text(
        f"{HEADER}{names[0]},7,,,,,,,\n{names[1]},9,1,2,3,0.6,0,-0.8,0\n"
    )
    first, second = every(Recording(folder))
    assert (first.name, first.frame.seq, first.frame.t_ns, first.frame.pose) == (
        "000002.png",
        0,
        7,
        None,
    )
    assert first.frame.image[0, 0, 0] == 20
    assert (second.name, second.frame.seq, second.frame.wall_ns) == ("000000.png", 1, 0)
    assert second.frame.pose == Pose(9, 1.0, 2.0, 3.0, 0.6, 0.0, -0.8, 0.0)


def test_without_a_table_the_times_are_made(folder: Path) -> None:
    (folder / "frames.csv").unlink()
    times = [recorded.frame.t_ns for recorded in every(Recording(folder))]
    assert times == [0, 33_333_333, 66_666_667]
    assert [r.frame.t_ns for r in every(Recording(folder, fps=100))] == [0, 10_000_000, 20_000_000]


def test_a_loop_goes_on_in_number_and_time(folder: Path) -> None:
    frames = every(Recording(folder, times=2))
    assert [r.frame.seq for r in frames] == [0, 1, 2, 3, 4, 5]
    assert [r.frame.t_ns for r in frames] == [500 + k * 10_000_000 for k in range(6)]
    assert frames[4].name == frames[1].name
    assert len(every(Recording(folder, times=0), most=50)) == 50
    assert [r.frame.t_ns for r in every(Recording(folder / "000001.png", fps=10, times=3))] == [
        0,
        10**8,
        2 * 10**8,
    ]


def test_a_video_with_and_without_a_table(video: Path) -> None:
    plain = every(Recording(video, fps=50))
    assert [(r.name, r.frame.t_ns) for r in plain] == [
        ("0", 0),
        ("1", 20_000_000),
        ("2", 40_000_000),
    ]
    assert [round(float(r.frame.image.mean()) / 80) for r in plain] == [0, 1, 2]
    video.with_suffix(".csv").write_text(HEADER + "0,5,,,,,,,\n1,6,,,,,,,\n2,9,,,,,,,\n")
    assert [r.frame.t_ns for r in every(Recording(video))] == [5, 6, 9]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (
            "0,5,,,,,,,\n1,6,,,,,,,\n",
            "row 3 is not that of frame 2, expected one row per video frame",
        ),
        ("0,5,,,,,,,\n2,6,,,,,,,\n", "row 2 is not that of frame 1, expected one row per"),
        (
            "".join(f"{k},{k},,,,,,,\n" for k in range(4)),
            "found 4 rows, expected 3, one per video frame",
        ),
    ],
)
def test_a_table_that_is_not_the_videos(video: Path, rows: str, said: str) -> None:
    video.with_suffix(".csv").write_text(HEADER + rows)
    with pytest.raises(ConfigError, match=said):
        every(Recording(video))


def test_nothing_to_replay(tmp_path: Path, folder: Path) -> None:
    with pytest.raises(ConfigError, match="found nothing, expected a folder"):
        Recording(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigError, match="found no image"):
        Recording(tmp_path / "empty")
    begun(tmp_path / "begun").close()
    with pytest.raises(ConfigError, match=r"frames\.csv\.part: found no rows"):
        Recording(tmp_path / "begun")
    with pytest.raises(ConfigError, match=r"found text that begins with .*, expected a video file"):
        Recording(folder / "frames.csv")
    with pytest.raises(
        ConfigError,
        match=(
            r"^--fps: found 20, expected no value, because .*frames\.csv contains the time stamps"
        ),
    ):
        Recording(folder, fps=20)


NOISE = np.random.default_rng(2)
POSE = Pose(1007, 0.1 + 0.2, -3.0, 1e-17, 0.6, 0.0, -0.8, 0.0)
BESIDE = {"calibration.npz", "settings.yaml"}


def drawn(*shape: int) -> U8:
    return NOISE.integers(0, 256, shape, dtype=np.uint8)


def begun(folder: Path) -> RecordingWriter:
    recorder = RecordingWriter(folder)
    recorder.begin("sensor_id: a\n", packed(painted_calibration()))
    return recorder


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3)])
def test_what_is_recorded_is_replayed_bit_by_bit(tmp_path: Path, shape: tuple[int, ...]) -> None:
    images = [drawn(*shape) for _ in range(3)]
    folder = tmp_path / "new" / "rec"
    recorder = begun(folder)
    for k, image in enumerate(images):
        assert recorder.add(
            Frame(10 + k, 1000 + 7 * k, 5, image, *((POSE, 431) if k == 1 else ())), png_of(image)
        )
    recorder.event(1001, "source", {"state": "away"})
    recorder.finish({"frames": recorder.frames})
    recording = Recording(folder)
    assert not recording.cut_off
    for k, image in enumerate(images):
        recorded = recording.read()
        assert recorded is not None
        frame = recorded.frame
        assert (frame.seq, frame.t_ns) == (k, 1000 + 7 * k)
        assert (frame.pose, frame.pose_error_us) == ((POSE, 431) if k == 1 else (None, 0))
        np.testing.assert_array_equal(frame.image, image)
    assert recording.read() is None
    names = {path.name for path in folder.iterdir()}
    assert names == BESIDE | {
        *(f"00000{k}.png" for k in range(3)),
        "frames.csv",
        "events.jsonl",
        "recording.json",
    }
    assert json.loads((folder / "recording.json").read_text()) == {"frames": 3}
    assert json.loads((folder / "events.jsonl").read_text()) == {
        "t_ns": 1001,
        "kind": "source",
        "data": {"state": "away"},
    }
    assert calibration_file.load(folder / "calibration.npz").crc32 == painted_calibration().crc32
    assert (folder / "settings.yaml").read_text() == "sensor_id: a\n"


@pytest.mark.parametrize("lost", [0, 12])
def test_after_a_crash_whole_frames_are_read(tmp_path: Path, lost: int) -> None:
    recorder = begun(tmp_path / "rec")
    for k in range(13):
        recorder.add(Frame(k, k, 0, drawn(8, 8)), png_of(drawn(8, 8)))
    recorder.close()
    table = tmp_path / "rec" / "frames.csv.part"
    table.write_bytes(table.read_bytes()[: -lost or None])
    (tmp_path / "rec" / "000013.png.part").write_bytes(b"half")
    recording = Recording(tmp_path / "rec")
    assert recording.cut_off
    read = 0
    while recording.read() is not None:
        read += 1
    assert read == 13 - (lost > 0)
    assert len(read_table(table, cut_off=True)) == read


def test_a_disk_at_its_floor_takes_no_frame(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = RecordingWriter(tmp_path / "png")
    recorder.begin("sensor_id: a\n", packed(painted_calibration()))
    monkeypatch.setattr("tacshade_edge.files.atomic_files.FREE_FLOOR_BYTES", 2**62)
    assert not recorder.add(Frame(0, 0, 0, drawn(8, 8)), b"")
    assert recorder.frames == 0
    assert not [path for path in recorder.folder.iterdir() if path.name.startswith("000")]
    recorder.close()
    with pytest.raises(DeviceError, match=r"found \d+ MiB free on the disk, expected at least \d+"):
        RecordingWriter(tmp_path / "rec")


def test_a_folder_that_cannot_be_taken(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    with pytest.raises(
        ConfigError, match=r"used: already exists, expected the name of a new folder"
    ):
        RecordingWriter(tmp_path / "used")
    (tmp_path / "used" / "a").touch()
    with pytest.raises(DeviceError, match=r"a: cannot write it: (File exists|Not a directory)"):
        RecordingWriter(tmp_path / "used" / "a" / "rec")


@pytest.mark.parametrize("number", ["NaN", "1" + "0" * 400, "-5", "true", "[]"])
def test_times_are_whole_numbers_within_bounds(tmp_path: Path, number: str) -> None:
    (tmp_path / "recording.json").write_text(f'{{"first_wall_ns": {number}, "first_t_ns": 5}}')
    assert wall_minus_t_ns(tmp_path) == 0
    (tmp_path / "events.jsonl").write_text(
        f'{{"t_ns": {number}, "kind": "start", "data": {{"wall_ns": 9}}}}\n'
        f'{{"t_ns": 5, "kind": "start", "data": {{"wall_ns": {number}}}}}\n'
        '{"t_ns": 5, "kind": "start", "data": {"wall_ns": 105}}\n'
    )
    assert wall_minus_t_ns(tmp_path) == 100
    assert [event.data["wall_ns"] for event in events_in(content_of(tmp_path))][-1] == 105


def test_a_frame_before_1970_has_no_sign(folder: Path) -> None:
    about = {"first_wall_ns": 10_000_000, "first_t_ns": 20_000_000}
    (folder / "recording.json").write_text(json.dumps(about))
    frames = every(Recording(folder))
    assert [(r.frame.t_ns, r.wall_ns) for r in frames] == [
        (500, 0),
        (10_000_500, 500),
        (20_000_500, 10_000_500),
    ]


def test_a_recording_of_a_hundred_years_is_not_repeated_beyond_64_bits(tmp_path: Path) -> None:
    path = write_recording(tmp_path / "long", [picture(0), picture(1)], 2**61)
    loops = Recording(path, times=0)
    times = [frame.frame.t_ns for _ in range(4) if (frame := loops.read())]
    assert times == [500 + k * 2**61 for k in range(4)]
    with pytest.raises(ConfigError, match=r"long: found a length of \d+ ns, expected one that can"):
        every(loops)


def test_what_is_too_large_is_refused(tmp_path: Path) -> None:
    lines = [json.dumps({"t_ns": 1, "kind": kind, "data": {}}) for kind in ("a", "b" * 70_000, "c")]
    assert [event.kind for event in events_in({"events.jsonl": "\n".join(lines).encode()})] == [
        "a",
        "c",
    ]
    with (tmp_path / "events.jsonl").open("wb") as stream:
        stream.truncate((32 << 20) + 1)
    with pytest.raises(ConfigError, match=r"events\.jsonl: found more than 33554432 bytes"):
        content_of(tmp_path)
