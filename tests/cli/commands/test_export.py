from __future__ import annotations

import json
import sys
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.csv_rows import csv_rows
from support.painted_sensor import BLACK, FREE, TOUCHED, painted_calibration, touched_depth_mm
from support.recordings import record_hand
from tacshade_edge.calibration.files.calibration_file import packed
from tacshade_edge.cli import EXIT_CONFIG, main
from tacshade_edge.recording.exports import table_export
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.sensor.touch.touch_answer import PLAIN
from tacshade_edge.types import Frame, Pose

IMAGES = [FREE, TOUCHED, TOUCHED, BLACK, FREE]
PERIOD_NS, T_NS, WALL_NS = 33_333_333, 500, 1_790_000_000_000_000_000


def record(folder: Path) -> Path:
    recorder = RecordingWriter(folder)
    recorder.begin("sensor_id: left-index\n", packed(painted_calibration()))
    recorder.event(T_NS - 1, "start", {"state": "streaming", "wall_ns": WALL_NS - 1})
    for seq, image in enumerate(IMAGES):
        t_ns = T_NS + seq * PERIOD_NS
        pose = Pose(t_ns, 100.0 + seq, 2.5, -3.0, 1.0, 0.0, 0.0, 0.0)
        recorder.add(Frame(seq, t_ns, t_ns + WALL_NS - T_NS, image, pose, 412), png_of(image))
    recorder.finish({"first_t_ns": T_NS, "first_wall_ns": WALL_NS})
    return folder


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return record(tmp_path / "rec")


def export(recording: Path, to: str, *more: str) -> int:
    return main(["export", str(recording), "--to", to, *more])


@pytest.mark.slow
def test_a_touch_of_unknown_depth_has_an_empty_cell(
    faint: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    calibration, pictures = faint
    more = ("--calibration", str(calibration), "--profile", "fast")
    assert export(pictures, "csv", *more) == 0
    assert "2 frames, 0 in contact, 1 touched (depth unknown), 0 invalid" in capsys.readouterr().out
    rows = csv_rows(pictures.with_name("pictures.csv"))
    found = [(row["contact"], row["touched"], row["depth_max_mm"]) for row in rows]
    assert found == [("0", "0", "0.0"), ("0", "1", "")]


def test_csv_has_a_row_for_each_frame_and_overwrites_nothing(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert export(recording, "csv") == 0
    path = recording.with_name("rec.csv")
    assert capsys.readouterr().out == f"{path}: 5 frames, 2 in contact, 1 invalid\n"
    rows = csv_rows(path)
    assert [row["contact"] for row in rows] == ["0", "1", "1", "", "0"]
    assert [row["valid"] for row in rows] == ["1", "1", "1", "0", "1"]
    assert float(rows[1]["depth_max_mm"]) == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert int(rows[2]["t_ns"]) == T_NS + 2 * PERIOD_NS
    assert int(rows[2]["wall_ns"]) == WALL_NS + 2 * PERIOD_NS
    assert float(rows[2]["flange_x_mm"]) == 102.0
    assert rows[0]["x_mm"] == rows[0]["touch_depth_mm"] == rows[0]["touch_sigma_depth_mm"] == ""
    assert float(rows[1]["touch_depth_mm"]) == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert float(rows[1]["touch_sigma_depth_mm"]) > 0
    assert [name for name in rows[0] if name.startswith("touch_sigma_")] == [
        f"touch_sigma_{name}" for name in PLAIN
    ]
    assert rows[3]["reason_code"] == "black"
    written = path.read_text()
    assert export(recording, "csv") == 78
    assert "already exists" in capsys.readouterr().err
    assert path.read_text() == written


def test_ply_has_the_cloud_of_each_contact(recording: Path) -> None:
    assert export(recording, "ply", "--out", str(recording.with_name("clouds"))) == 0
    files = sorted(recording.with_name("clouds").iterdir())
    assert [path.name for path in files] == ["000001.ply", "000002.ply"]
    head, _, body = files[0].read_bytes().partition(b"end_header\n")
    points = np.frombuffer(body, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("object", "<u2")])
    assert f"element vertex {len(points)}\n".encode() in head
    assert set(points["object"]) == {1}
    assert 15 < points["z"].min() < points["z"].max() < 20


@pytest.mark.slow
def test_mcap_opens_in_its_own_library(recording: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    from foxglove_schemas_protobuf.Log_pb2 import Log

    assert export(recording, "mcap") == 0
    messages: dict[str, list[Any]] = {}
    with recording.with_name("rec.mcap").open("rb") as stream:
        opened = reader.make_reader(stream, validate_crcs=True)
        for _, channel, message in opened.iter_messages():
            messages.setdefault(channel.topic.removeprefix("/tacshade/left-index/"), []).append(
                message
            )
        attached = {found.name: found.data for found in opened.iter_attachments()}
    counts = {topic: len(found) for topic, found in messages.items()}
    assert counts == {
        "camera": 5,
        "frame": 5,
        "height": 5,
        "cloud": 5,
        "contact": 5,
        "touch": 5,
        "tf": 6,
        "log": 1,
    }
    log = Log.FromString(messages["log"][0].data)
    assert (log.message[:7], log.timestamp.ToNanoseconds()) == ("start: ", WALL_NS - 1)
    assert sorted(attached) == [
        "calibration.npz",
        "events.jsonl",
        "recording.json",
        "settings.yaml",
    ]
    assert attached["calibration.npz"] == (recording / "calibration.npz").read_bytes()
    check_second_frame(messages)


def check_second_frame(messages: dict[str, list[Any]]) -> None:
    """Check what is said of the first frame of a touch."""
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
    from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    camera = CompressedImage.FromString(messages["camera"][1].data)
    np.testing.assert_array_equal(
        cv2.imdecode(np.frombuffer(camera.data, np.uint8), cv2.IMREAD_UNCHANGED), TOUCHED
    )
    stamps = {
        messages["camera"][1].log_time,
        messages["camera"][1].publish_time,
        camera.timestamp.ToNanoseconds(),
    }
    assert stamps == {WALL_NS + PERIOD_NS}
    height = RawImage.FromString(messages["height"][1].data)
    assert np.nanmax(np.frombuffer(height.data, "<f4")) == pytest.approx(
        touched_depth_mm(), abs=1e-6
    )
    cloud = PointCloud.FromString(messages["cloud"][1].data)
    assert len(cloud.data) % cloud.point_stride == 0
    assert [field.offset for field in cloud.fields] == [0, 4, 8, 12]
    mounted, flange = (
        FrameTransforms.FromString(message.data).transforms[0] for message in messages["tf"][:2]
    )
    assert (mounted.parent_frame_id, mounted.child_frame_id) == (
        "left-index/flange",
        "left-index/sensor",
    )
    assert (flange.parent_frame_id, flange.translation.x) == ("left-index/base", pytest.approx(0.1))
    assert json.loads(messages["contact"][1].data)["t_ns"] == T_NS + PERIOD_NS
    free, touched = (json.loads(message.data) for message in messages["touch"][:2])
    assert (free["touch"], list(touched["touch"])) == (None, list(PLAIN))


@pytest.mark.slow
def test_mcap_is_replayed_and_exported_as_the_folder(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mcap.reader")
    assert export(recording, "mcap") == 0
    mcap, first, second = (str(recording.with_name(name)) for name in ("rec.mcap", "a", "b"))
    assert main(["replay", str(recording), "--out", first]) == 0
    assert main(["replay", mcap, "--out", second, "--against", first]) == 0
    assert "is the same as" in capsys.readouterr().out
    # It has its own calibration too.
    assert export(Path(mcap), "csv", "--out", str(recording.with_name("again.csv"))) == 0
    assert export(recording, "csv") == 0
    assert (
        recording.with_name("again.csv").read_bytes() == recording.with_name("rec.csv").read_bytes()
    )


def test_an_unreadable_image_is_left_out_and_reported(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording / "000002.png").write_bytes(b"no image")
    assert export(recording, "csv") == 1
    said = capsys.readouterr()
    assert "000002.png" in said.err
    assert said.out.endswith("4 frames, 1 in contact, 1 invalid, 1 unreadable\n")


def test_without_a_calibration_it_asks_for_one(
    recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (recording / "calibration.npz").unlink()
    assert export(recording, "csv") == 78
    assert "pass --calibration CAL.npz" in capsys.readouterr().err
    assert sorted(path.name for path in recording.parent.iterdir()) == ["rec"]


def test_a_missing_extra_is_named(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("mcap", "mcap.reader", "foxglove_schemas_protobuf"):
        monkeypatch.setitem(sys.modules, module, None)
    assert export(recording, "mcap") == 78
    assert "to install it: pip install '.[mcap]' in the clone" in capsys.readouterr().err


@pytest.mark.slow
def test_recordings_of_a_hands_fingers_are_its_messages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fingers = [str(path) for path in record_hand(tmp_path)]
    assert main(["export", *fingers, "--to", "csv", "--out", str(tmp_path / "hand.csv")]) == 0
    rows = csv_rows(tmp_path / "hand.csv")
    assert (
        capsys.readouterr().out == f"{tmp_path / 'hand.csv'}: {len(rows)} messages of 2 fingers\n"
    )
    (touching, *_) = (
        row for row in rows if row["left-thumb_state"] == row["left-index_state"] == "contact"
    )
    assert float(touching["left-index_depth_max_mm"]) == pytest.approx(touched_depth_mm(), abs=1e-3)
    assert float(touching["translation_x_mm"]) == pytest.approx(0, abs=0.01)
    assert float(touching["sigma_rotation_x_deg"]) > 0
    assert rows[-1]["motion_since_ns"] == ""
    next(Path(fingers[1]).glob("*.png")).write_bytes(b"no image")
    assert main(["export", *fingers, "--to", "csv", "--out", str(tmp_path / "torn.csv")]) == 1
    assert capsys.readouterr().out.endswith(" messages of 2 fingers, 1 image unreadable\n")


@pytest.mark.slow
def test_mcaps_of_a_hand_and_of_a_finger_have_their_names(tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap.reader")
    fingers = [str(path) for path in record_hand(tmp_path)]
    assert main(["export", *fingers, "--to", "mcap", "--out", str(tmp_path / "hand.mcap")]) == 0
    with (tmp_path / "hand.mcap").open("rb") as stream:
        topics = {channel.topic for _, channel, _ in reader.make_reader(stream).iter_messages()}
    assert topics == {"/tacshade/hand/left/objects"}
    assert export(Path(fingers[0]), "mcap") == 0
    assert b"/tacshade/left-thumb/camera" in (tmp_path / "left-thumb.mcap").read_bytes()


@pytest.mark.parametrize(
    ("more", "option"),
    [
        (("--to", "ply", "--out", "x"), "--to: "),
        (("--to", "csv"), "--out: "),
        (("--to", "csv", "--calibration", "c.npz"), "--calibration: "),
    ],
)
def test_what_does_not_go_with_a_hand(
    more: tuple[str, ...], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", "a", "b", *more]) == 78
    assert capsys.readouterr().err.startswith(f"tacshade-edge: {option}")


def test_an_export_that_has_just_ended_is_not_replaced(
    recording: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ends after the other's check, and before the other's lock."""
    out = recording.with_name("rec.csv")
    locked = table_export.one_at_a_time

    def late(path: Path, *words: str) -> AbstractContextManager[None]:
        out.write_text("the other's")
        return locked(path, *words)

    monkeypatch.setattr(table_export, "one_at_a_time", late)
    assert export(recording, "csv") == EXIT_CONFIG
    said = capsys.readouterr().err
    assert (said.count("\n"), "rec.csv: already exists" in said) == (1, True)
    assert out.read_text() == "the other's"
    assert {path.name for path in recording.parent.iterdir()} == {"rec", "rec.csv"}
