"""The dashboard's server in this process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager
from typing import Any

from tacshade_edge.dashboard import server
from tacshade_edge.dashboard.bridge import Broker as Address
from tools.testbed.patience import patience

TOKEN = "a-token-of-this-test"


def run(test: Coroutine[Any, Any, None]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(patience(30)):
            await test

    asyncio.run(limited())


@asynccontextmanager
async def running(
    broker_port: int = 1, origins: frozenset[str] = frozenset(), host: str = "127.0.0.1", **access: Any
) -> AsyncIterator[int]:
    """The server in this process; its port."""
    port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
    stop = asyncio.Event()
    serving = asyncio.create_task(
        server.run(
            Address(host, broker_port), "127.0.0.1", 0, origins, lambda _host, p: port.set_result(p), stop, **access
        )
    )
    yield await port
    stop.set()
    await serving
