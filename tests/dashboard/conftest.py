"""One browser, and one calibration, for all tests of the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver import Chrome
from support.browser import browser, errors, errors_of_the_page

from tacshade_edge.demo.sensor import make_calibration
from tacshade_edge.storage.calibration import calibration_file


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
    """The browser; a test that ends with a complaint of the page in the console has failed."""
    errors(chromium)
    yield chromium
    complaints = errors_of_the_page(chromium)
    chromium.get("about:blank")
    assert complaints == []
