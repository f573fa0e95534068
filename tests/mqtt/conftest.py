"""A broker, a link to it and a subscriber."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from support.link_rig import BASE, Rig
from support.mqtt_rig import Broker, Subscriber


@pytest.fixture
def rig(broker: Broker) -> Iterator[Rig]:
    made = Rig(broker.port).connect()
    yield made
    broker.resume()
    made.link.stop(2)


@pytest.fixture
def subscriber(broker: Broker) -> Iterator[Subscriber]:
    with Subscriber(broker.port, f"{BASE}/#") as made:
        yield made
