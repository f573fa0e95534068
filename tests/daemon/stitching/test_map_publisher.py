import json

import numpy as np
import pytest

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.daemon import session as map_publisher
from tacshade_edge.daemon.session import MapPublisher, MapRevision, thinned_points
from tacshade_edge.protocol.wire import CloudMessage, decode


def raster(rows: int = 40, cols: int = 50) -> Raster:
    z = np.arange(rows * cols, dtype=np.float32).reshape(rows, cols) / 1000
    z[:3] = np.nan
    return Raster(z, 5.0, -2.0, 0.25)


def revision(number: int, folder: str = "", of: Raster | None = None) -> MapRevision:
    return MapRevision("pad", number, 3, 2, 0xABCD, folder, lambda: of or raster())


def test_a_growing_map_is_told_once_a_second_and_the_last_one_always(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[tuple[str, bytes]] = []
    publisher = MapPublisher(lambda topic, payload: told.append((topic, payload)))
    assert [publisher.publish(revision(k + 1)) for k in range(5)] == [False, True, True, True, True]
    assert not publisher.publish(revision(6, "/sessions/pad"))
    assert [topic for topic, _ in told] == ["map/cloud", "map/revision", "map/cloud", "map/final"]
    monkeypatch.setattr(map_publisher, "PERIOD_S", -1.0)
    publisher.publish(revision(7, "/sessions/pad"))
    publisher.publish(revision(8))
    assert len(told) == 8  # a period after the one before


def test_a_subscriber_decodes_the_map() -> None:
    told: dict[str, bytes] = {}
    MapPublisher(told.__setitem__).publish(revision(9, "/sessions/pad"))
    about = json.loads(told["map/final"])
    assert (about["name"], about["revision"], about["presses"], about["used"]) == ("pad", 9, 3, 2)
    assert (about["width_mm"], about["length_mm"], about["spacing_mm"]) == (12.5, 10.0, 0.25)
    assert about["area_mm2"] == 37 * 50 / 16
    assert about["folder"] == "/sessions/pad"
    cloud = decode(told["map/cloud"])
    assert isinstance(cloud, CloudMessage)
    assert (cloud.seq, cloud.calibration_crc32, cloud.pose) == (9, 0xABCD, None)
    assert len(cloud.points_mm) == about["points"] == 37 * 50
    np.testing.assert_allclose(cloud.points_mm, raster().points(), atol=1e-5)


def test_a_large_map_is_told_with_fewer_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(map_publisher, "POINTS_MAX", 300)
    points, spacing_mm = thinned_points(raster())
    assert 100 < len(points) <= 300
    assert spacing_mm == 0.75
    every = {tuple(p) for p in np.round(raster().points(), 4).tolist()}
    assert all(tuple(p) in every for p in np.round(points.astype(float), 4).tolist())


def test_an_empty_map_is_told() -> None:
    told: dict[str, bytes] = {}
    MapPublisher(told.__setitem__).publish(revision(1, of=Raster(np.full((1, 1), np.nan, np.float32), 0.0, 0.0, 0.25)))
    assert json.loads(told["map/revision"])["z_min_mm"] is None
    assert len(decode(told["map/cloud"]).points_mm) == 0  # type: ignore[union-attr]
