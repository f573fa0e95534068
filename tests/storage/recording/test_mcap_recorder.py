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
from support.mcap_bytes import CHUNK, SCHEMA, flipped, record_starts

from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.storage.recording import mcap_recorder
from tacshade_edge.storage.recording.mcap_recorder import McapRecorder, fix_recordings
from tacshade_edge.storage.recording.recorder import png_of
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


def every(path: Path) -> tuple[list[int], list[str]]:
    """Numbers of the frames; and what was told."""
    recording, found, told = Recording(path), [], []
    while True:
        try:
            if (recorded := recording.read()) is None:
                return found, told
        except DecodeError as error:
            told.append(str(error))
            continue
        found.append(int(recorded.name[:6]))


def test_a_recording_opens_whole_and_each_of_its_files_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_recorder, "FILE_NS_MAX", 10 * PERIOD_NS)
    folder = tmp_path / "rec"
    begun(folder, 25).finish({"frames": 25})
    files = sorted(path.name for path in folder.glob("*.mcap*"))
    assert files == ["000.mcap", "001.mcap", "002.mcap"]
    assert seqs(folder) == list(range(25))
    assert not Recording(folder).cut_off
    assert [event.kind for event in events_in(content_of(folder))] == ["start"]
    for name in files:
        with (folder / name).open("rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            assert {found.name for found in reader.iter_attachments()} == {CALIBRATION_NAME, "settings.yaml"}
            summary = reader.get_summary()
            assert summary is not None
            assert len(summary.chunk_indexes) >= 3


@pytest.mark.slow
def test_after_a_cut_at_any_of_100_bytes_the_next_start_fixes_it(tmp_path: Path) -> None:
    recorder = begun(tmp_path / "rec", 30)  # half a second
    part = tmp_path / "rec" / "000.mcap.part"
    whole = part.read_bytes()
    assert fix_recordings(tmp_path) == []  # it is being written to
    recorder.close()
    draw = random.Random(3)
    for at in (draw.randrange(100, len(whole)) for _ in range(100)):
        part.write_bytes(whole[:at])
        assert len(fix_recordings(tmp_path)) == 1
        assert fix_recordings(tmp_path) == []
        fixed = part.with_suffix("")
        with fixed.open("rb") as stream:
            frames = sum(
                channel.topic == "/tacshade/left/camera" for _, channel, _ in make_reader(stream).iter_messages()
            )
        assert frames >= 30 * at // len(whole) - 2
        if at % 10 == 0 and frames:
            assert seqs(tmp_path / "rec") == list(range(frames))
            assert not Recording(tmp_path / "rec").cut_off
        fixed.unlink()


def test_blocks_that_a_power_cut_left_empty_end_it(tmp_path: Path) -> None:
    recorder = begun(tmp_path / "rec", 5)
    recorder.close()
    part = tmp_path / "rec" / "000.mcap.part"
    with part.open("ab") as stream:
        stream.write(bytes(70_000))
    (fixed,) = fix_recordings(tmp_path)
    assert b"\0" * 60_000 not in fixed.read_bytes()
    assert seqs(tmp_path / "rec") == [0, 1, 2, 3, 4]


def test_fixing_keeps_what_stands_behind_damage(tmp_path: Path) -> None:
    recorder = begun(tmp_path / "rec", 12)
    recorder.close()
    part = tmp_path / "rec" / "000.mcap.part"
    content = part.read_bytes()
    chunks = [begin for begin in record_starts(content) if content[begin] == CHUNK]
    assert len(chunks) == 12
    # In the picture of the first chunk, which has schemas and channels; in the fifth's length; in the ninth's kind.
    for byte, bit in ((chunks[0] + 5000, 2), (chunks[4] + 3, 4), (chunks[8], 0)):
        content = flipped(content, byte, bit)
    part.write_bytes(content[:-50])
    assert len(fix_recordings(tmp_path)) == 1
    frames, refused = every(tmp_path / "rec" / "000.mcap")
    assert frames == [1, 2, 3, 5, 6, 7, 9, 10, 11]
    assert len(refused) == 3
    assert all("skipping the damaged" in line for line in refused)


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


def test_it_is_read_while_it_grows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_recorder, "FILE_NS_MAX", 4 * PERIOD_NS)
    recorder = begun(tmp_path / "rec", 1)
    for seq in range(1, 13):
        assert Recording(tmp_path / "rec").cut_off
        assert every(tmp_path / "rec") == (list(range(seq)), [])
        recorder.add(frame(seq), png_of(frame(seq).image))
    recorder.finish({"frames": 13})
    assert every(tmp_path / "rec") == (list(range(13)), [])


def test_a_kill_between_two_files_leaves_the_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_recorder, "FILE_NS_MAX", 3 * PERIOD_NS)
    begun(tmp_path / "rec", 6).close()
    (tmp_path / "rec" / "001.mcap.part").write_bytes(b"")  # before its first byte reached the disk
    assert fix_recordings(tmp_path) == []
    recording = Recording(tmp_path / "rec")
    assert "001.mcap.part: not an MCAP file" in recording.damage
    assert every(tmp_path / "rec")[0] == [0, 1, 2, 3]


def test_what_is_not_even_begun_stays(tmp_path: Path) -> None:
    for name, content in (("a", b""), ("b", b"\x89MCAP0\r\n"), ("c", b"something else")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "000.mcap.part").write_bytes(content)
    assert fix_recordings(tmp_path) == []
    assert len(list(tmp_path.glob("*/*.part"))) == 3
    assert fix_recordings(tmp_path / "none") == []


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
    assert [path.name for path in (tmp_path / "rec").glob("*.mcap*")] == ["000.mcap"]
    assert seqs(tmp_path / "rec") == [0, 1, 2]
