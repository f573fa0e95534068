from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.daemon.session import RefusedError, Session
from tacshade_edge.protocol.results import PressAdded, SessionAborted, SessionBegun
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.storage.stitching.stitch_file import StitchFile
from tools.testbed.bumpy_surface import grid_poses, press_of
from tools.testbed.painted_sensor import painted_calibration

POSES = grid_poses()[:3]


def begun(folder: Path, name: str = "pad") -> Session:
    session = Session.begin(folder, name, painted_calibration(), "left")
    for k, pose in enumerate(POSES):
        assert session.add(press_of(pose, k), pose, 10 + k) == PressAdded(k + 1, 10 + k, 600)
    return session


def test_a_session_is_resumed_as_it_was(tmp_path: Path) -> None:
    assert Session.resume(tmp_path, "left") is None
    session = begun(tmp_path)
    assert session.begun() == SessionBegun("pad")
    session.close()
    again = Session.resume(tmp_path, "left")
    assert again is not None
    assert again.status(0) == session.status(0)
    (ended, final), (_, other) = session.finish(2), again.finish(2)
    assert (ended.name, ended.presses, ended.used) == ("pad", 3, 3)
    assert (final.revision, final.folder) == (4, str(tmp_path / "pad"))
    np.testing.assert_array_equal(final.raster().z_mm, other.raster().z_mm)
    about = json.loads((tmp_path / "pad" / "map.json").read_text())
    assert (about["used"], about["missed"]) == (3, 2)
    assert [record["press"] for record in about["presses"]] == [1, 2, 3]
    for record in about["presses"]:
        assert set(record) == {"press", "used", "reason", "points", "moved_mm", "turned_deg"}
        assert record["used"]
        assert record["points"] > 0
    assert Session.resume(tmp_path, "left") is None


def test_the_files_of_a_session_are_those_of_every_version(tmp_path: Path) -> None:
    """``session.json`` and ``presses.bin`` written by hand: sessions on a disk outlive an upgrade."""
    folder = tmp_path / "old"
    folder.mkdir()
    info = '{"name": "old", "begun_wall_ns": 5, "calibration_crc32": 77, "skin_radius_mm": 20.0, '
    (folder / "session.json").write_text(info + '"state": "open", "version": 1}')
    pose = (1.0, 0, 0, 0, 1, 0, 0, 0, 1, 100, 200, 0)
    points = [(x, 0.0, 20.0, 0, 0, 1, 0.5) for x in (0.0, 0.25, 0.5)]
    body = struct.pack("<12d", *pose) + b"".join(struct.pack("<7f", *point) for point in points)
    (folder / "presses.bin").write_bytes(struct.pack("<4sII", b"TCSP", len(body), zlib.crc32(body)) + body)
    session = Session.resume(tmp_path, "left")
    assert session is not None
    assert (session.name, session.presses, session.points) == ("old", 1, 3)
    np.testing.assert_allclose(session.map_revision().raster().points()[0], (100, 200, 20))
    session.add(press_of(POSES[0], 0), POSES[0], 1)
    session.close()
    written = (folder / "presses.bin").read_bytes()
    assert written.startswith(struct.pack("<4sII", b"TCSP", len(body), zlib.crc32(body)) + body)
    assert len(written) == 2 * 12 + len(body) + 12 * 8 + 600 * 28


@pytest.mark.parametrize(
    ("name", "code"), [("pad", ReasonCode.NAME_TAKEN), ("../x", ReasonCode.BAD_NAME), ("x" * 65, ReasonCode.BAD_NAME)]
)
def test_names_that_are_refused(tmp_path: Path, name: str, code: ReasonCode) -> None:
    begun(tmp_path).close()
    with pytest.raises(RefusedError) as caught:
        Session.begin(tmp_path, name, painted_calibration(), "left")
    assert caught.value.reason.code == code


def test_a_full_map_refuses_and_an_aborted_session_is_gone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    session = begun(tmp_path)
    monkeypatch.setattr("tacshade_edge.core.stitching.stitcher.POINTS_MAX", 2000)
    with pytest.raises(RefusedError) as caught:
        session.add(press_of(POSES[0], 0), POSES[0], 13)
    assert caught.value.reason.code == ReasonCode.MAP_FULL
    assert session.status(1).presses == 3
    session.close()
    assert len(StitchFile.resume(tmp_path / "pad")[1]) == 3  # it is not on the disk either
    assert session.abort() == SessionAborted("pad", 3)
    assert [*tmp_path.iterdir()] == []
