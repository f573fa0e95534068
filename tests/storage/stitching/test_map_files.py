import contextlib
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.core.stitching.surface_map import Raster
from tacshade_edge.storage.meshes.ply import ply
from tacshade_edge.storage.pictures.map_preview import MARGIN_PX, PREVIEW_PX, preview, tick_step_mm
from tacshade_edge.storage.stitching.map_files import write_map


def raster(rows: int = 30, cols: int = 40, height_mm: float = 2.0) -> Raster:
    z = np.linspace(-1, -1 + height_mm, rows * cols, dtype=np.float32).reshape(rows, cols)
    z[5:8, 5:8] = np.nan
    return Raster(z, 10.0, -20.0, 0.25)


@pytest.mark.parametrize("height_mm", [2.0, 200.0])
def test_the_16_bit_picture_holds_the_heights(tmp_path: Path, height_mm: float) -> None:
    given = raster(height_mm=height_mm)
    write_map(tmp_path / "new" / "folder", given, {"revision": 7})
    folder = tmp_path / "new" / "folder"
    about = json.loads((folder / "map.json").read_text())
    assert about["revision"] == 7
    assert about["touched_mm2"] == (30 * 40 - 9) / 16
    levels = cv2.imread(str(folder / "map.png"), cv2.IMREAD_UNCHANGED)
    scale = about["png"]["scale_mm"]
    found = np.where(levels > 0, about["png"]["z0_mm"] + (levels.astype(float) - 1) * scale, np.nan)
    np.testing.assert_allclose(found, given.z_mm, atol=0.51 * scale + 1e-5)
    assert sorted(p.name for p in folder.iterdir()) == ["map.json", "map.npz", "map.ply", "map.png", "preview.png"]


@pytest.mark.parametrize("renames", range(7))
def test_a_kill_leaves_no_two_maps_beside_a_manifest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, renames: int
) -> None:
    write_map(tmp_path, raster(), {"revision": 1})
    old = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    left, replace = renames, os.replace

    def killed(source: Path, target: Path) -> None:
        nonlocal left
        if target.suffix != ".new":
            if not left:
                raise KeyboardInterrupt  # which nothing here catches, as a kill
            left -= 1
        replace(source, target)

    monkeypatch.setattr(os, "replace", killed)
    with contextlib.suppress(KeyboardInterrupt):
        write_map(tmp_path, raster(rows=31, height_mm=3.0), {"revision": 2})
    changed = {(tmp_path / name).read_bytes() != data for name, data in old.items() if name != "map.json"}
    if (tmp_path / "map.json").exists():
        assert changed == {json.loads((tmp_path / "map.json").read_text())["revision"] == 2}
    monkeypatch.undo()
    write_map(tmp_path, raster(), {"revision": 1})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == old


def test_the_preview_has_y_upwards_and_holes_in_grey() -> None:
    picture = preview(raster())
    zoom, left = PREVIEW_PX // 40, MARGIN_PX
    assert (picture[(30 - 7) * zoom + zoom // 2, left + 6 * zoom + zoom // 2] == 225).all()
    top, bottom = picture[2, left + 2].astype(int), picture[30 * zoom - 3, left + 2].astype(int)
    assert top.sum() != bottom.sum()
    assert max(preview(raster(3000, 10)).shape) < 1000
    assert preview(Raster(np.full((1, 1), np.nan, np.float32), 0, 0, 0.25)).ndim == 3


def test_the_preview_has_axes_in_millimetres() -> None:
    """40 cells of 0.25 mm from x 10, 30 from y -20: a tick at each 2 mm, in line with the cell that is there."""
    rows, cols, left = 30, 40, MARGIN_PX
    picture = preview(raster(rows, cols))
    zoom = PREVIEW_PX // cols
    below, beside = picture[rows * zoom + 2, left:], picture[: rows * zoom, left - 3]
    at = [(x - 10) / 0.25 * zoom + zoom / 2 for x in (10, 12, 14, 16, 18)]
    assert np.flatnonzero((below == 0).all(axis=1)) == pytest.approx(at, abs=1)
    at = [(rows - 1 - (y + 20) / 0.25) * zoom + zoom / 2 for y in (-14, -16, -18, -20)]
    assert np.flatnonzero((beside == 0).all(axis=1)) == pytest.approx(at, abs=1)
    assert (picture[rows * zoom + 8 :, left : left + 20] < 128).any(), "numbers below the ticks"
    assert (picture[:, : left - 6] < 128).any(), "and beside them"


@pytest.mark.parametrize(
    ("span_mm", "step_mm"), [(0.25, 0.05), (1.0, 0.2), (10, 2), (20, 5), (57, 20), (99, 20), (750, 200)]
)
def test_ticks_are_at_round_numbers(span_mm: float, step_mm: float) -> None:
    assert tick_step_mm(span_mm) == pytest.approx(step_mm)


def test_the_ply_says_how_many() -> None:
    data = ply(raster().points(), "millimetres, base frame")
    assert data.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert len(data.split(b"end_header\n", 1)[1]) == 12 * (30 * 40 - 9)
