import contextlib
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from tacshade_edge.stitching.map_files import write_map
from tacshade_edge.stitching.stitcher import Raster


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
    assert sorted(p.name for p in folder.iterdir()) == [
        "map.json",
        "map.npz",
        "map.ply",
        "map.png",
        "preview.png",
    ]


@pytest.mark.parametrize("renames", [0, 1, 3, 5, 6])
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
    changed = {
        (tmp_path / name).read_bytes() != data for name, data in old.items() if name != "map.json"
    }
    if (tmp_path / "map.json").exists():
        assert changed == {json.loads((tmp_path / "map.json").read_text())["revision"] == 2}
    monkeypatch.undo()
    write_map(tmp_path, raster(), {"revision": 1})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == old
