"""A stitching session: its presses on disk and in the map, and what is published of the map."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from support.bumpy_surface import grid_poses, press_of
from support.painted_sensor import painted_calibration
from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.stitching import session as map_publisher
from tacshade_edge.stitching.session import MapPublisher, MapRevision, StitchSession, thinned_points
from tacshade_edge.stitching.stitch_file import StitchFile
from tacshade_edge.stitching.stitcher import Raster
from tacshade_edge.wire.binary import CloudMessage, decode
from tacshade_edge.wire.results import PressAdded


def raster(rows: int = 40, cols: int = 50) -> Raster:
    z = np.arange(rows * cols, dtype=np.float32).reshape(rows, cols) / 1000
    z[:3] = np.nan
    return Raster(z, 5.0, -2.0, 0.25)


def revision(number: int, folder: str = "", of: Raster | None = None) -> MapRevision:
    return MapRevision("pad", number, 3, 2, 0xABCD, folder, lambda: of or raster())


def test_a_growing_map_is_reported_once_a_second_and_the_last_one_always(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reported: list[tuple[str, bytes]] = []
    publisher = MapPublisher(lambda topic, payload: reported.append((topic, payload)))
    assert [publisher.publish(revision(k + 1)) for k in range(5)] == [False, True, True, True, True]
    assert not publisher.publish(revision(6, "/sessions/pad"))
    assert [topic for topic, _ in reported] == [
        "map/cloud",
        "map/revision",
        "map/cloud",
        "map/final",
    ]
    monkeypatch.setattr(map_publisher, "PERIOD_S", -1.0)
    publisher.publish(revision(7, "/sessions/pad"))
    publisher.publish(revision(8))
    assert len(reported) == 8  # a period after the one before


def test_a_subscriber_decodes_the_map() -> None:
    reported: dict[str, bytes] = {}
    MapPublisher(reported.__setitem__).publish(revision(9, "/sessions/pad"))
    about = json.loads(reported["map/final"])
    assert (about["name"], about["revision"], about["presses"], about["used"]) == ("pad", 9, 3, 2)
    assert (about["width_mm"], about["length_mm"], about["spacing_mm"]) == (12.5, 10.0, 0.25)
    assert about["area_mm2"] == 37 * 50 / 16
    assert about["folder"] == "/sessions/pad"
    cloud = decode(reported["map/cloud"])
    assert isinstance(cloud, CloudMessage)
    assert (cloud.seq, cloud.calibration_crc32, cloud.pose) == (9, 0xABCD, None)
    assert len(cloud.points_mm) == about["points"] == 37 * 50
    np.testing.assert_allclose(cloud.points_mm, raster().points(), atol=1e-5)


def test_a_large_map_is_reported_with_fewer_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_publisher, "POINTS_MAX", 300)
    points, spacing_mm = thinned_points(raster())
    assert 100 < len(points) <= 300
    assert spacing_mm == 0.75
    every = {tuple(p) for p in np.round(raster().points(), 4).tolist()}
    assert all(tuple(p) in every for p in np.round(points.astype(float), 4).tolist())


POSES = grid_poses()[:3]


def begun(folder: Path, name: str = "pad") -> StitchSession:
    session = StitchSession.begin(folder, name, painted_calibration(), "left")
    for k, pose in enumerate(POSES):
        assert session.add(press_of(pose, k), pose, 10 + k) == PressAdded(k + 1, 10 + k, 600)
    return session


def test_the_files_of_a_session_are_those_of_every_version(tmp_path: Path) -> None:
    """``session.json`` and ``presses.bin`` written by hand:
    sessions on a disk outlive an upgrade.
    """
    folder = tmp_path / "old"
    folder.mkdir()
    info = '{"name": "old", "begun_wall_ns": 5, "calibration_crc32": 77, "skin_radius_mm": 20.0, '
    (folder / "session.json").write_text(info + '"state": "open", "version": 1}')
    pose = (1.0, 0, 0, 0, 1, 0, 0, 0, 1, 100, 200, 0)
    points = [(x, 0.0, 20.0, 0, 0, 1, 0.5) for x in (0.0, 0.25, 0.5)]
    body = struct.pack("<12d", *pose) + b"".join(struct.pack("<7f", *point) for point in points)
    (folder / "presses.bin").write_bytes(
        struct.pack("<4sII", b"TCSP", len(body), zlib.crc32(body)) + body
    )
    session = StitchSession.resume(tmp_path, "left")
    assert session is not None
    assert (session.name, session.presses, session.points) == ("old", 1, 3)
    np.testing.assert_allclose(session.map_revision().raster().points()[0], (100, 200, 20))
    session.add(press_of(POSES[0], 0), POSES[0], 1)
    session.file.close()
    written = (folder / "presses.bin").read_bytes()
    assert written.startswith(struct.pack("<4sII", b"TCSP", len(body), zlib.crc32(body)) + body)
    assert len(written) == 2 * 12 + len(body) + 12 * 8 + 600 * 28


def test_a_full_map_refuses_and_an_aborted_session_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = begun(tmp_path)
    monkeypatch.setattr("tacshade_edge.stitching.stitcher.POINTS_MAX", 2000)
    with pytest.raises(DeviceError) as caught:
        session.add(press_of(POSES[0], 0), POSES[0], 13)
    assert caught.value.reason.code == ReasonCode.MAP_FULL
    assert session.status(1).presses == 3
    session.file.close()
    assert len(StitchFile.resume(tmp_path / "pad")[1]) == 3  # it is not on the disk either
    session.file.remove()
    assert [*tmp_path.iterdir()] == []
