"""Claims of the README."""

from __future__ import annotations

import re

import pytest

from support.figures.cost import million_instructions
from support.result_page import FAMILIES, ROOT, Claims, Page, rounded


def readme() -> Claims:
    """The default profile's, wherever a page has profiles."""
    assert re.search(r"^profile: balanced$", (ROOT / "config/default.yaml").read_text(encoding="utf-8"), re.MULTILINE)
    trained, other = (Page("objects", family) for family in FAMILIES.values())
    mean = ("mean", "balanced")
    error, elsewhere = (rounded(page.cell("ME mm", *mean), 2) for page in (trained, other))
    yield f"**{error} mm** mean distance from the true surface ({elsewhere} mm on another sensor family)"
    depth = ("balanced", "depth")
    real = Page("real-raw")
    order, off = real.cell("rank correlation", *depth), real.cell("mean error", *depth)
    presses = real.cell("frames", *depth)
    yield (
        f"**{order}** rank correlation with true depth, {off} mm mean error after a linear fit | "
        f"{presses} presses of a real TacTip"
    )
    latency = Page("daemon")
    yield f"**{latency.cell('p50 ms', 'contact')} ms** latency, 99 % within {latency.cell('p99 ms', 'contact')} ms"
    per_s = (2.4e9 * 2.8, 2.4e9 * 1.4)  # instructions of a Pi 5's core, as in tools/ci/run_arm.py
    cores = [rounded(100 * 5 * 30 * 1e6 * million_instructions("balanced") / rate, 0) for rate in per_s]
    yield f"**Five fingers** at 30 frames/s use {cores[0]} to {cores[1]} % of a core"


CLAIMS = (pytest.param("README.md", readme, id="readme"),)
