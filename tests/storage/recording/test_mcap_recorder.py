from __future__ import annotations

import errno
import os
import random
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap")
pytest.importorskip("foxglove_schemas_protobuf")
from mcap.reader import NonSeekingReader, make_reader
from support.mcap_bytes import CHUNK, SCHEMA, record_starts

from tacshade_edge.errors import DeviceError
from tacshade_edge.storage.recording import recorder as recorder_module
from tacshade_edge.storage.recording.recorder import McapRecorder, png_of
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.recording.recording_content import CALIBRATION_NAME, content_of, events_in
from tacshade_edge.types import U8, Frame, Pose
from tools.testbed.painted_sensor import painted_calibration

WALL_NS, PERIOD_NS = 1_790_000_000_000_000_000, 16_666_667


def picture(seq: int) -> U8:
    return np.random.default_rng(seq).integers(0, 256, (120, 160), dtype=np.uint8)


def frame(seq: int) -> Frame:
    t_ns = 1000 + seq * PERIOD_NS
    return Frame(seq, t_ns, WALL_NS + t_ns, picture(seq), Pose(t_ns, 1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0), 5)


def begun(folder: Path, frames: int) -> McapRecorder:
    recorder = McapRecorder(folder, "left")
    recorder.begin("sensor_id: left\n", painted_calibration())
    recorder.event(5, "start", {})
    for seq in range(frames):
        assert recorder.add(frame(seq), png_of(frame(seq).image))
    recorder.sync()
    return recorder


def seqs(folder: Path) -> list[int]:
    recording, found = Recording(folder), []
    while (recorded := recording.read()) is not None:
        seq = int(recorded.name[:6])
        np.testing.assert_array_equal(recorded.frame.image, picture(seq))
        assert (recorded.frame.t_ns, recorded.frame.pose) == (frame(seq).t_ns, frame(seq).pose)
        found.append(seq)
    return found


def test_a_recording_opens_whole_and_each_of_its_files_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recorder_module, "FILE_NS_MAX", 4 * PERIOD_NS)
    folder = tmp_path / "rec"
    recorder = begun(folder, 1)
    for seq in range(1, 13):
        assert Recording(folder).cut_off
        assert seqs(folder) == list(range(seq))  # it is read while it grows
        recorder.add(frame(seq), png_of(frame(seq).image))
    recorder.finish({"frames": 13})
    files = sorted(path.name for path in folder.glob("*.mcap*"))
    assert files == ["000.mcap", "001.mcap", "002.mcap"]
    assert seqs(folder) == list(range(13))
    assert not Recording(folder).cut_off
    assert [event.kind for event in events_in(content_of(folder))] == ["start"]
    for name in files:
        with (folder / name).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert {found.name for found in reader.iter_attachments()} == {CALIBRATION_NAME, "settings.yaml"}
            assert (summary := reader.get_summary()) is not None
            assert len(summary.chunk_indexes) >= 3


def test_after_a_cut_at_any_byte_the_frames_before_are_read(tmp_path: Path) -> None:
    begun(tmp_path / "rec", 30).close()  # half a second
    part = tmp_path / "rec" / "000.mcap.part"
    whole = part.read_bytes()
    for after in (b"", bytes(70_000)):  # blocks that a power cut left empty
        part.write_bytes(whole + after)
        assert seqs(tmp_path / "rec") == list(range(30))
    draw = random.Random(3)
    for at in (draw.randrange(len(whole) // 8, len(whole)) for _ in range(8)):
        part.write_bytes(whole[:at])
        found = seqs(tmp_path / "rec")
        assert found == list(range(len(found)))
        assert len(found) >= 30 * at // len(whole) - 2


def test_a_standard_reader_needs_no_first_chunk(tmp_path: Path) -> None:
    begun(tmp_path / "rec", 5).finish({"frames": 5})
    path = tmp_path / "rec" / "000.mcap"
    content = path.read_bytes()
    first, second = (begin for begin in record_starts(content)[:20] if content[begin] == CHUNK)
    after = next(begin for begin in record_starts(content) if first < begin < second and content[begin] == SCHEMA)
    path.write_bytes(content[:first] + content[after:])
    with path.open("rb") as stream:
        found = [channel.topic for _, channel, _ in NonSeekingReader(stream).iter_messages()]
    assert found.count("/tacshade/left/camera") == 4
    assert found.count("/tacshade/left/frame") == 4


def test_a_disk_that_fails_amid_a_record_leaves_the_frames_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = begun(tmp_path / "rec", 3)

    def fail(*_args: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        writer = recorder._open[1]  # type: ignore[index]
        patch.setattr(writer, "frame", fail)
        with pytest.raises(DeviceError, match="No space left"):
            recorder.add(frame(3), b"")
    recorder.finish({"frames": 3})
    assert [path.name for path in (tmp_path / "rec").glob("*.mcap*")] == ["000.mcap.part"]
    assert seqs(tmp_path / "rec") == [0, 1, 2]
