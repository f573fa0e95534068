"""Hypothesis, for all tests: no time limit per example (machines are shared),
and a failure can be repeated.

Where CI is set, the examples are few and the same in every run:
one there judges the change, one at the desk looks for news.
"""

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from support import shared
from support.examples import AT_DESK, at_most
from support.mqtt_rig import MOSQUITTO, Broker, Subscriber
from tacshade_edge.cli.shared.logs import OneLineHandler

settings.register_profile(
    "tacshade",
    deadline=None,
    print_blob=True,
    derandomize="CI" in os.environ,
    max_examples=at_most(AT_DESK),
)
settings.load_profile("tacshade")


LONG_S = 1800
"""The time limit of a test that needs more than this process."""
LONG_MARKS = {"broker", "browser", "fit", "node", "slow"}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with those that wait longest, so that no worker has them left
    when the others are done; give tests the time limit of their mark, and skip those that need a
    broker where there is none.
    """
    items.sort(key=lambda item: "service" not in item.path.parts)
    for item in items:
        marks = {mark.name for mark in item.iter_markers()}
        if "container" in marks:
            item.add_marker(pytest.mark.timeout(2 * LONG_S))
        elif marks & LONG_MARKS and "timeout" not in marks:
            item.add_marker(pytest.mark.timeout(LONG_S))
        if "broker" in marks and MOSQUITTO is None:
            item.add_marker(pytest.mark.skip("mosquitto is not installed"))


@pytest.fixture(autouse=True, scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Where the workers of this run leave what they made for each other;
    one process alone needs none.
    """
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared.folder = tmp_path_factory.getbasetemp().parent


@pytest.fixture(autouse=True)
def own_log() -> Iterator[None]:
    """A command's log ends with its test: its stream is closed for those that follow."""
    root = logging.getLogger()
    before, level = root.handlers[:], root.level
    yield
    for handler in [handler for handler in root.handlers if handler not in before]:
        if isinstance(handler, OneLineHandler):
            root.removeHandler(handler)
            root.setLevel(level)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    with Broker(tmp_path) as started:
        yield started


@pytest.fixture
def seen(broker: Broker) -> Iterator[Subscriber]:
    with Subscriber(broker.port) as subscriber:
        yield subscriber
