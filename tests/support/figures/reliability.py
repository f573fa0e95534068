"""Claims about faults."""

from __future__ import annotations

import pytest

from support.result_page import Claims, Page


def faults() -> Claims:
    page = Page("faults")
    back = max(page.number("recovered s", fault) for fault in ("broker killed, and back", "connection reset"))
    assert back <= 3
    yield "the daemon reconnects within 3 s of the broker's return"
    stalled = [page.number("detected s", fault) for fault in ("broker stalls for 6 s", "network carries nothing")]
    assert min(stalled) >= 4
    assert max(stalled) <= 15
    yield "reports the hang after 4 to 15 s"
    assert page.number("detected s", "lens covered, and uncovered") <= 4
    assert page.number("recovered s", "lens covered, and uncovered") <= 2
    yield "`degraded` within 4 s; frames resume within 2 s of the camera's return"
    assert page.number("recovered s", "no calibration at the start") <= 2
    yield "uses a new calibration within 2 s"


CLAIMS = (pytest.param("docs/explanation/reliability.md", faults, id="faults"),)
