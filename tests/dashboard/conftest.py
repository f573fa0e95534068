"""One browser, and one calibration, for all tests of the page;
a broker, its dashboard and a sensor for each.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium.webdriver import Chrome

from support.browser import browser, errors, errors_of_the_page
from support.dashboard_process import dashboard
from support.mqtt_rig import Broker, Subscriber
from support.page_server import run
from support.published_sensor import PublishedSensor
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.lab.demo.demo_hand import make_calibration


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


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


@pytest.fixture
def address(broker: Broker) -> Iterator[str]:
    """The page's, of a dashboard of this broker."""
    with dashboard(f"127.0.0.1:{broker.port}") as address:
        yield address


@pytest.fixture
def sensor(broker: Broker) -> Iterator[PublishedSensor]:
    with PublishedSensor(broker.port) as published:
        yield published


@pytest.fixture
def seen(broker: Broker) -> Iterator[Subscriber]:
    """What the page asks of any sensor."""
    with Subscriber(broker.port, "tacshade/+/req/+") as subscriber:
        yield subscriber
