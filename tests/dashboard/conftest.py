"""One browser, and one calibration, for all tests of the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.browser import browser, errors


@pytest.fixture(scope="session")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("sensor") / "calibration.npz"
    calibration_file.save(path, make_calibration())
    return path


@pytest.fixture(scope="session")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chrome]:
    with browser(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


@pytest.fixture
def page(chromium: Chrome) -> Iterator[Chrome]:
    """The browser; a test that ends with a complaint in the console has failed.

    But for the browser's own about what was under way while the test's server ended, before the page.
    """
    errors(chromium)
    yield chromium
    own = (
        "WebSocket is already in CLOSING or CLOSED state",
        "/favicon.svg - Failed to load resource",
        "failed: Error in connection establishment: net::ERR_CONNECTION_REFUSED",
    )
    told = [e for e in errors(chromium) if not any(text in e for text in own)]
    chromium.get("about:blank")
    assert told == []
