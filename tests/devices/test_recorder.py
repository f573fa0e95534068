from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.devices.recorder import Recorder
from tacshade_edge.devices.recording import Recording, read_table
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.types import U8, Frame

NOISE = np.random.default_rng(2)


def picture(*shape: int) -> U8:
    return NOISE.integers(0, 256, shape, dtype=np.uint8)


@pytest.mark.parametrize("shape", [(48, 64), (48, 64, 3)])
def test_what_is_recorded_is_replayed_bit_by_bit(tmp_path: Path, shape: tuple[int, ...]) -> None:
    images = [picture(*shape) for _ in range(3)]
    recorder = Recorder(tmp_path / "new" / "rec", free_floor_bytes=0)
    for k, image in enumerate(images):
        assert recorder.add(Frame(10 + k, 1000 + 7 * k, 5, image))
    recorder.finish({"frames": recorder.frames})
    recording = Recording(tmp_path / "new" / "rec")
    for k, image in enumerate(images):
        recorded = recording.read()
        assert recorded is not None
        assert (recorded.frame.seq, recorded.frame.t_ns, recorded.pose) == (k, 1000 + 7 * k, None)
        np.testing.assert_array_equal(recorded.frame.image, image)
    assert recording.read() is None
    names = {path.name for path in (tmp_path / "new" / "rec").iterdir()}
    assert names == {"000000.png", "000001.png", "000002.png", "frames.csv", "recording.json"}
    assert json.loads((tmp_path / "new" / "rec" / "recording.json").read_text()) == {"frames": 3}


def test_after_a_crash_the_table_names_whole_images_only(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, free_floor_bytes=0)
    for k in range(130):
        recorder.add(Frame(k, k, 0, picture(8, 8)))
    rows = read_table(tmp_path / "frames.csv")
    assert len(rows) == 121
    assert all((tmp_path / row.image).is_file() for row in rows)
    assert not list(tmp_path.glob("*.part"))


def test_a_disk_at_its_floor_takes_no_frame(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, free_floor_bytes=2**62)
    assert not recorder.add(Frame(0, 0, 0, picture(8, 8)))
    assert recorder.frames == 0
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_taken(tmp_path: Path) -> None:
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "a.png").touch()
    with pytest.raises(ConfigError, match=r"used: found a\.png in it, expected a new or empty folder"):
        Recorder(tmp_path / "used")
    with pytest.raises(DeviceError, match=r"a\.png: cannot be written: File exists"):
        Recorder(tmp_path / "used" / "a.png")
    recorder = Recorder(tmp_path / "gone", free_floor_bytes=0)
    (tmp_path / "gone").rmdir()
    with pytest.raises(DeviceError, match=r"gone.*: cannot be written: No such file"):
        recorder.add(Frame(0, 0, 0, picture(8, 8)))
