"""The shipped networks, read once for every test of a process: a reconstructor of its own takes 50 ms to read them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import pytest

from tacshade_edge.core.depth import Network
from tacshade_edge.inference import network
from tacshade_edge.inference.network import load_networks


@cache
def _read() -> dict[str, Network]:
    return load_networks()


@pytest.fixture(autouse=True, scope="module")
def shared_networks() -> Iterator[None]:
    """As the daemon's parts share them (`preload`)."""
    network._for_all.update(_read())
    yield
    network._for_all.clear()
