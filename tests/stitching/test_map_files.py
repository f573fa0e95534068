import contextlib
import itertools
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from support.rasters import raster
from tacshade_edge.stitching.map_files import write_map


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


CALLS = ("replace", "link", "unlink", "fsync", "mkdir", "rmdir")


@pytest.mark.parametrize("has_links", [True, False])
def test_a_kill_at_any_call_leaves_the_old_map_or_the_new_one_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, has_links: bool
) -> None:
    write_map(tmp_path, raster(), {"revision": 1})
    old = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    manifest, is_whole = tmp_path / "map.json", False
    for done in itertools.count():
        left = done

        def or_killed(name: str) -> Callable[..., Any]:
            real = getattr(os, name)

            def call(*words: Any, **more: Any) -> Any:
                nonlocal left
                if not left:
                    raise KeyboardInterrupt  # which nothing here catches, as a kill
                left -= 1
                if name == "link" and not has_links:
                    raise PermissionError
                return real(*words, **more)

            return call

        with monkeypatch.context() as killing, contextlib.suppress(KeyboardInterrupt):
            for name in CALLS:
                killing.setattr(os, name, or_killed(name))
            write_map(tmp_path, raster(rows=31, height_mm=3.0), {"revision": 2})
            is_whole = True
        found = {name: (tmp_path / name).read_bytes() for name in old if name != manifest.name}
        changed = {data != old[name] for name, data in found.items()}
        if manifest.exists():
            assert changed == {json.loads(manifest.read_text())["revision"] == 2}
        else:
            previous = tmp_path / "map-previous"
            assert {path.name: path.read_bytes() for path in previous.iterdir()} == old
        write_map(tmp_path, raster(), {"revision": 1})
        assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == old
        if is_whole:
            break
    assert done > 20
