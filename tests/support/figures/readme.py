"""Claims of the README."""

from __future__ import annotations

import re

import pytest

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
    frame_ms = Page("arm").cell("Pi 5 (Cortex-A76, 2.4 GHz), ms", "balanced", "contact").split(" to ")
    cores = [rounded(5 * 30 * float(ms) / 10, 0) for ms in frame_ms]
    yield f"**Five fingers** at 30 frames/s use {cores[0]} to {cores[1]} % of a core"


CLAIMS = (pytest.param("README.md", readme, id="readme"),)
