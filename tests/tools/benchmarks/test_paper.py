"""The transcription of the paper that profile `paper` is measured by, and the bench that does it."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest

from tacshade_edge.core.depth import hybrid_sfs
from tacshade_edge.core.image.grey_maps import GreyMaps
from tacshade_edge.core.image.total_variation import chambolle
from tools.benchmarks import plain_paper
from tools.testbed.patience import patience


def test_it_is_what_the_profile_computes() -> None:
    rows, cols = np.mgrid[:40, :50]
    g_d = (80 * np.exp(-((rows - 20) ** 2 + (cols - 25) ** 2) / 60)).astype(np.float32)
    g0 = np.full(g_d.shape, 120, np.float32)
    maps = GreyMaps(g=g0 + g_d, g0=g0, g_d=g_d, inside=np.hypot(rows - 20, cols - 25) < 19)
    plain, ours = (solve(maps, 3.0) for solve in (plain_paper.solve, hybrid_sfs.hybrid_depth))
    np.testing.assert_allclose(plain.height_mm, ours.height_mm, atol=3e-3)
    assert ours.height_mm.max() == pytest.approx(3, rel=1e-6)
    assert plain.repaired_px == ours.repaired_px == 0
    image = g_d / np.float32(255)
    assert np.array_equal(plain_paper.denoise(image, 0.1, 200), chambolle(image, 0.1, 200))


@pytest.mark.slow
def test_the_bench_says_what_each_costs_and_finds() -> None:
    command = [sys.executable, "-m", "tools.benchmarks.paper", "--rounds", "1", "--frames", "20", "--objects", "ball"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=patience(300), check=False)
    assert (done.returncode, done.stderr) == (0, "")
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in done.stdout.splitlines() if line[:1] == "|"]
    found = {name: [float(cell) for cell in cells] for name, *cells in rows[2:]}
    assert list(found) == ["plain", "paper", "balanced", "fast"]
    assert all(0 < p50 <= p99 for p50, p99, *_ in found.values())
    assert found["balanced"][2] == 1
    assert found["plain"][2] > found["paper"][2] > 10  # a busy machine does not change that
    assert found["plain"][3:] == found["paper"][3:]  # ME, SD
    assert re.search(r"^Heights of plain are at most \S+ % of the greatest off those of paper$", done.stdout, re.M)
