from __future__ import annotations

import csv
import io
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support.recorded_hand import record_hand

from tacshade_edge.cli import main
from tacshade_edge.cli.commands import export as command
from tacshade_edge.core.touch.answer import PLAIN
from tacshade_edge.storage.recording.recorder import Recorder, png_of
from tacshade_edge.types import Frame, Pose
from tools.testbed.painted_sensor import BLACK, FREE, TOUCHED, painted_calibration, touched_depth_mm

IMAGES = [FREE, TOUCHED, TOUCHED, BLACK, FREE]
PERIOD_NS, T_NS, WALL_NS = 33_333_333, 500, 1_790_000_000_000_000_000


def record(folder: Path, *, finished: bool = True) -> Path:
    recorder = Recorder(folder)
    recorder.begin("sensor_id: left-index\n", painted_calibration())
    recorder.event(T_NS - 1, "start", {"state": "streaming", "wall_ns": WALL_NS - 1})
    for seq, image in enumerate(IMAGES):
        t_ns = T_NS + seq * PERIOD_NS
        pose = Pose(t_ns, 100.0 + seq, 2.5, -3.0, 1.0, 0.0, 0.0, 0.0)
        recorder.add(Frame(seq, t_ns, t_ns + WALL_NS - T_NS, image, pose, 412), png_of(image))
    recorder.sync()
    if finished:
        recorder.finish({"first_t_ns": T_NS, "first_wall_ns": WALL_NS})
    else:
        recorder.close()
    return folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return record(tmp_path / "rec")


def export(recording: Path, to: str, *more: str) -> int:
    return main(["export", str(recording), "--to", to, *more])


def test_csv_has_a_row_for_each_frame(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert export(recording, "csv") == 0
    path = recording.with_name("rec.csv")
    assert capsys.readouterr().out == f"{path}: 5 frames, 2 in contact, 1 invalid\n"
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    assert [row["contact"] for row in rows] == ["0", "1", "1", "0", "0"]
    assert [row["valid"] for row in rows] == ["1", "1", "1", "0", "1"]
    assert float(rows[1]["depth_max_mm"]) == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert int(rows[2]["t_ns"]) == T_NS + 2 * PERIOD_NS
    assert int(rows[2]["wall_ns"]) == WALL_NS + 2 * PERIOD_NS
    assert float(rows[2]["flange_x_mm"]) == 102.0
    assert rows[0]["x_mm"] == rows[0]["touch_depth_mm"] == rows[0]["touch_sigma_depth_mm"] == ""
    assert float(rows[1]["touch_depth_mm"]) == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert float(rows[1]["touch_sigma_depth_mm"]) > 0
    assert [name for name in rows[0] if name.startswith("touch_sigma_")] == [f"touch_sigma_{name}" for name in PLAIN]
    assert rows[3]["reason_code"] == "black"


def test_ply_has_the_cloud_of_each_contact(recording: Path) -> None:
    assert export(recording, "ply", "--out", str(recording.with_name("clouds"))) == 0
    files = sorted(recording.with_name("clouds").iterdir())
    assert [path.name for path in files] == ["000001.ply", "000002.ply"]
    head, _, body = files[0].read_bytes().partition(b"end_header\n")
    points = np.frombuffer(body, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("object", "<u2")])
    assert f"element vertex {len(points)}\n".encode() in head
    assert b"property ushort object\n" in head
    assert set(points["object"]) == {1}
    assert 15 < points["z"].min() < points["z"].max() < 20


@pytest.fixture
def opened(recording: Path) -> Iterator[Any]:
    """The library's own reader and decoder, on our file."""
    reader = pytest.importorskip("mcap.reader")
    assert export(recording, "mcap") == 0
    with recording.with_name("rec.mcap").open("rb") as stream:
        yield reader.make_reader(stream, validate_crcs=True)


def test_mcap_opens_in_its_own_library(opened: Any, recording: Path) -> None:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.Log_pb2 import Log
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    messages: dict[str, list[Any]] = {}
    for schema, channel, message in opened.iter_messages():
        messages.setdefault(channel.topic, []).append((schema.name, message))
    root = "/tacshade/left-index"
    counts = {topic.removeprefix(f"{root}/"): len(found) for topic, found in messages.items()}
    assert counts == {"camera": 5, "frame": 5, "height": 5, "cloud": 5, "contact": 5, "touch": 5, "tf": 6, "log": 1}
    schema, message = messages[f"{root}/camera"][1]
    camera = CompressedImage.FromString(message.data)
    assert (schema, camera.format) == ("foxglove.CompressedImage", "png")
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(camera.data, np.uint8), cv2.IMREAD_UNCHANGED), TOUCHED)
    assert message.log_time == message.publish_time == WALL_NS + PERIOD_NS
    assert camera.timestamp.ToNanoseconds() == WALL_NS + PERIOD_NS
    height = RawImage.FromString(messages[f"{root}/height"][1][1].data)
    cells_mm = np.frombuffer(height.data, "<f4").reshape(height.height, height.width)
    assert np.nanmax(cells_mm) == pytest.approx(touched_depth_mm(), abs=1e-6)
    cloud = PointCloud.FromString(messages[f"{root}/cloud"][1][1].data)
    assert len(cloud.data) % cloud.point_stride == 0
    assert [field.offset for field in cloud.fields] == [0, 4, 8, 12]
    mounted, flange = (FrameTransforms.FromString(m.data).transforms[0] for _, m in messages[f"{root}/tf"][:2])
    assert (mounted.parent_frame_id, mounted.child_frame_id) == ("left-index/flange", "left-index/sensor")
    assert (flange.parent_frame_id, flange.translation.x) == ("left-index/base", pytest.approx(0.1))
    contact = json.loads(messages[f"{root}/contact"][1][1].data)
    assert contact["t_ns"] == T_NS + PERIOD_NS
    free, touched = (json.loads(message.data) for _, message in messages[f"{root}/touch"][:2])
    assert (free["touch"], list(touched["touch"])) == (None, list(PLAIN))
    assert touched["wall_ns"] == contact["wall_ns"]
    log = Log.FromString(messages[f"{root}/log"][0][1].data)
    assert log.message.startswith("start: ")
    assert log.timestamp.ToNanoseconds() == WALL_NS - 1
    attached = {found.name: found.data for found in opened.iter_attachments()}
    assert sorted(attached) == ["calibration.npz", "events.jsonl", "recording.json", "settings.yaml"]
    assert attached["calibration.npz"] == (recording / "calibration.npz").read_bytes()


def test_a_replay_of_the_mcap_is_that_of_the_folder(
    opened: Any, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration = ["--calibration", str(recording / "calibration.npz")]
    runs = recording.with_name("a"), recording.with_name("b")
    assert main(["replay", str(recording), *calibration, "--out", str(runs[0])]) == 0
    mcap = str(recording.with_name("rec.mcap"))
    assert main(["replay", mcap, *calibration, "--out", str(runs[1]), "--against", str(runs[0])]) == 0
    assert "is the same as" in capsys.readouterr().out
    # It has its own calibration too.
    assert export(Path(mcap), "csv", "--out", str(recording.with_name("again.csv"))) == 0
    assert export(recording, "csv") == 0
    assert recording.with_name("again.csv").read_bytes() == recording.with_name("rec.csv").read_bytes()


def test_lerobots_layout(recording: Path) -> None:
    pq = pytest.importorskip("pyarrow.parquet")
    assert export(recording, "lerobot") == 0
    root = recording.with_name("rec-lerobot")
    info = json.loads((root / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", 30, 5)
    table = pq.read_table(root / "data/chunk-000/file-000.parquet")
    assert set(table.column_names) == set(info["features"])
    rows = table.to_pylist()
    assert [row["timestamp"] for row in rows] == pytest.approx([k / 30 for k in range(5)])
    height = np.array(rows[1]["observation.tactile.height_mm"])
    assert list(height.shape) == info["features"]["observation.tactile.height_mm"]["shape"]
    assert height.max() == pytest.approx(touched_depth_mm(), abs=1e-6)
    image = cv2.imdecode(np.frombuffer(rows[1]["observation.images.tactile"]["bytes"], np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(image[:, :, 0], TOUCHED)
    assert info["features"]["observation.tactile.touch"]["names"] == list(PLAIN)
    assert rows[1]["observation.tactile.touch"][0] == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert [any(row["observation.tactile.touch_sigma"]) for row in rows] == [False, True, True, False, False]
    stats = json.loads((root / "meta/stats.json").read_text())
    contacts = np.array([row["observation.tactile.contact"] for row in rows])
    told = stats["observation.tactile.contact"]
    for name, expected in (("mean", contacts.mean(0)), ("std", contacts.std(0)), ("max", contacts.max(0))):
        np.testing.assert_allclose(told[name], expected, atol=1e-6)
    assert np.shape(stats["observation.images.tactile"]["std"]) == (3, 1, 1)


def test_lerobots_own_loader(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(os.environ, "HF_HUB_OFFLINE", "1")
    lerobot = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    assert export(recording, "lerobot") == 0
    found = lerobot.LeRobotDataset("tacshade/rec", root=recording.with_name("rec-lerobot"))
    assert len(found) == 5
    item = found[1]
    assert item["task"] == "touch"
    assert item["observation.images.tactile"].shape == (3, *TOUCHED.shape)
    assert float(item["observation.tactile.height_mm"].max()) == pytest.approx(touched_depth_mm(), abs=1e-6)
    assert item["observation.state"][0] == 101.0


def test_a_recording_that_was_cut_off_has_its_wall_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = record(tmp_path / "rec", finished=False)
    assert export(recording, "csv") == 0
    assert "was cut off" in capsys.readouterr().err
    rows = list(csv.DictReader(io.StringIO(recording.with_name("rec.csv").read_text())))
    assert [int(row["wall_ns"]) for row in rows] == [WALL_NS + k * PERIOD_NS for k in range(5)]


def test_a_format_is_its_entry_alone(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, begin = command.FORMATS["csv"]
    monkeypatch.setitem(command.FORMATS, "table", ("-table.txt", begin))
    assert export(recording, "table") == 0
    assert len(recording.with_name("rec-table.txt").read_text().splitlines()) == 1 + len(IMAGES)


def test_what_is_there_is_not_overwritten(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording.with_name("rec.csv").write_text("mine")
    assert export(recording, "csv") == 78
    assert "already exists, expected a new name (--out)" in capsys.readouterr().err
    assert recording.with_name("rec.csv").read_text() == "mine"


def test_an_unreadable_image_is_left_out_and_told(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (recording / "000002.png").write_bytes(b"no image")
    assert export(recording, "csv") == 1
    said = capsys.readouterr()
    assert "000002.png" in said.err
    assert said.out.endswith("4 frames, 1 in contact, 1 invalid, 1 unreadable\n")


def test_without_a_calibration_it_asks_for_one(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (recording / "calibration.npz").unlink()
    assert export(recording, "csv") == 78
    assert "contains no calibration.npz; pass --calibration CAL.npz" in capsys.readouterr().err
    assert sorted(path.name for path in recording.parent.iterdir()) == ["rec"]


@pytest.mark.parametrize(("to", "module"), [("mcap", "mcap.reader"), ("lerobot", "pyarrow")])
def test_a_missing_extra_is_named(
    to: str, module: str, recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    if to == "mcap":
        monkeypatch.setitem(sys.modules, "foxglove_schemas_protobuf", None)
    assert export(recording, to) == 78
    assert f"to install it: pip install '.[{to}]' in the clone" in capsys.readouterr().err


def test_recordings_of_a_hands_fingers_are_its_messages(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fingers = [str(path) for path in record_hand(tmp_path)]
    assert main(["export", *fingers, "--to", "csv", "--out", str(tmp_path / "hand.csv")]) == 0
    rows = list(csv.DictReader(io.StringIO((tmp_path / "hand.csv").read_text())))
    assert capsys.readouterr().out == f"{tmp_path / 'hand.csv'}: {len(rows)} messages of 2 fingers\n"
    (touching, *_) = (row for row in rows if row["left-thumb_state"] == row["left-index_state"] == "contact")
    assert float(touching["left-index_depth_max_mm"]) == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert float(touching["translation_x_mm"]) == pytest.approx(0, abs=0.01)
    assert float(touching["sigma_rotation_x_deg"]) > 0
    assert rows[-1]["motion_since_ns"] == rows[-1]["left-thumb_margin"] == ""
    mcap = pytest.importorskip("mcap.reader")
    assert main(["export", *fingers, "--to", "mcap", "--out", str(tmp_path / "hand.mcap")]) == 0
    with (tmp_path / "hand.mcap").open("rb") as stream:
        found = [(channel.topic, json.loads(m.data)) for _, channel, m in mcap.make_reader(stream).iter_messages()]
    assert {topic for topic, _ in found} == {"/tacshade/hand/left/objects"}
    assert [message["seq"] for _, message in found] == [int(row["seq"]) for row in rows]


def test_an_image_of_a_hand_that_cannot_be_read_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    thumb, index = record_hand(tmp_path)
    next(index.glob("*.png")).write_bytes(b"no image")
    assert main(["export", str(thumb), str(index), "--to", "csv", "--out", str(tmp_path / "hand.csv")]) == 1
    assert capsys.readouterr().out.endswith(" messages of 2 fingers, 1 images unreadable\n")


@pytest.mark.parametrize(
    ("more", "line"),
    [
        (("--to", "ply", "--out", "x"), "--to: found ply for 2 recordings, expected csv or mcap"),
        (("--to", "csv"), "--out: found no file name, expected the name of a new"),
        (("--to", "csv", "--calibration", "c.npz"), "--calibration: found a calibration for several recordings"),
    ],
)
def test_what_does_not_go_with_a_hand(more: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "a", "b", *more]) == 78
    assert line in capsys.readouterr().err


def test_a_fingers_recording_has_its_own_name(tmp_path: Path) -> None:
    pytest.importorskip("mcap")
    thumb, _ = record_hand(tmp_path)
    assert export(thumb, "mcap") == 0
    assert b"/tacshade/left-thumb/camera" in (tmp_path / "left-thumb.mcap").read_bytes()
