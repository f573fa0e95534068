from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.storage.calibration import calibration_file
from tacshade_edge.storage.recording.mcap_recorder import McapRecorder
from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.tables.frame_table import read_table
from tacshade_edge.types import U8, Frame, Pose
from tools.testbed.painted_sensor import painted_calibration

NOISE = np.random.default_rng(2)
POSE = Pose(1007, 0.1 + 0.2, -3.0, 1e-17, 0.6, 0.0, -0.8, 0.0)
BESIDE = {"calibration.npz", "settings.yaml"}


def picture(*shape: int) -> U8:
    return NOISE.integers(0, 256, shape, dtype=np.uint8)


def begun(folder: Path) -> Recorder:
    recorder = Recorder(folder, free_floor_bytes=0)
    recorder.begin("sensor_id: a\n", painted_calibration())
    return recorder


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3)])
def test_what_is_recorded_is_replayed_bit_by_bit(tmp_path: Path, shape: tuple[int, ...]) -> None:
    images = [picture(*shape) for _ in range(3)]
    folder = tmp_path / "new" / "rec"
    recorder = begun(folder)
    for k, image in enumerate(images):
        assert recorder.add(Frame(10 + k, 1000 + 7 * k, 5, image, *((POSE, 431) if k == 1 else ())), png_of(image))
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
    assert names == BESIDE | {*(f"00000{k}.png" for k in range(3)), "frames.csv", "events.jsonl", "recording.json"}
    assert json.loads((folder / "recording.json").read_text()) == {"frames": 3}
    assert json.loads((folder / "events.jsonl").read_text()) == {
        "t_ns": 1001,
        "kind": "source",
        "data": {"state": "away"},
    }
    assert calibration_file.load(folder / "calibration.npz").crc32 == painted_calibration().crc32
    assert (folder / "settings.yaml").read_text() == "sensor_id: a\n"


def test_a_recording_of_a_recording_is_the_same(tmp_path: Path) -> None:
    first = begun(tmp_path / "a")
    for k in range(3):
        image = picture(8, 8)
        first.add(Frame(k, 1000 + 7 * k, 5, image, POSE if k == 1 else None), png_of(image))
    first.finish({})
    again, recording = begun(tmp_path / "b"), Recording(tmp_path / "a")
    while (recorded := recording.read()) is not None:
        again.add(recorded.frame, png_of(recorded.frame.image))
    again.finish({})
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes(), path.name


@pytest.mark.parametrize("lost", [0, 1, 12])
def test_after_a_crash_whole_frames_are_read(tmp_path: Path, lost: int) -> None:
    recorder = begun(tmp_path / "rec")
    for k in range(130):
        recorder.add(Frame(k, k, 0, picture(8, 8)), png_of(picture(8, 8)))
    recorder.close()
    table = tmp_path / "rec" / "frames.csv.part"
    table.write_bytes(table.read_bytes()[: -lost or None])
    (tmp_path / "rec" / "000130.png.part").write_bytes(b"half")
    recording = Recording(tmp_path / "rec")
    assert recording.cut_off
    read = 0
    while recording.read() is not None:
        read += 1
    assert read == 130 - (lost > 0)
    assert len(read_table(table, cut_off=True)) == read


def test_before_the_first_frame_there_is_nothing_to_replay(tmp_path: Path) -> None:
    begun(tmp_path / "rec").close()
    with pytest.raises(ConfigError, match=r"frames\.csv\.part: found no rows"):
        Recording(tmp_path / "rec")


def test_a_disk_at_its_floor_takes_no_frame(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match=r"found \d+ MiB free on the disk, expected at least \d+"):
        Recorder(tmp_path / "rec", free_floor_bytes=2**62)
    for recorder in (Recorder(tmp_path / "png"), McapRecorder(tmp_path / "mcap", "left")):
        recorder.begin("sensor_id: a\n", painted_calibration())
        recorder._floor = 2**62
        assert not recorder.add(Frame(0, 0, 0, picture(8, 8)), b"")
        assert recorder.frames == 0
        assert not [path for path in recorder.folder.iterdir() if path.name.startswith("000")]
        recorder.close()


def test_a_folder_that_cannot_be_taken(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    with pytest.raises(ConfigError, match=r"used: already exists, expected the name of a new folder"):
        Recorder(tmp_path / "used", free_floor_bytes=0)
    (tmp_path / "used" / "a").touch()
    with pytest.raises(DeviceError, match=r"a: cannot write it: (File exists|Not a directory)"):
        Recorder(tmp_path / "used" / "a" / "rec", free_floor_bytes=0)


def test_a_damaged_line_costs_its_frame_and_is_told(tmp_path: Path) -> None:
    recorder = begun(tmp_path / "rec")
    images = [picture(8, 8) for _ in range(4)]
    for k, image in enumerate(images):
        recorder.add(Frame(k, 1000 + k, 0, image, POSE, 5), png_of(image))
    recorder.finish({})
    table = tmp_path / "rec" / "frames.csv"
    assert Recording(tmp_path / "rec").damage == ""
    table.write_bytes(table.read_bytes().replace(b"000001.png,1001", b"000002.png,1001"))
    recording = Recording(tmp_path / "rec")
    assert recording.damage.startswith(f"{table}:3: left out a damaged line")
    for k in (0, 2, 3):
        recorded = recording.read()
        assert recorded is not None
        assert (recorded.name, recorded.frame.t_ns) == (f"00000{k}.png", 1000 + k)
        np.testing.assert_array_equal(recorded.frame.image, images[k])
    assert recording.read() is None
