"""A node of ROS 2 in a Zenoh network: one session as a client of a router, its publishers and who
listens to them.
"""

from __future__ import annotations

import json
import time
from typing import Any, Final

import zenoh
from zenoh import ext
from zenoh.handlers import FifoChannel

from tacshade_edge.bridge.ros_graph import (
    EVERYBODY,
    Listeners,
    RosNode,
    RosTopic,
    attachment,
    gid_of,
)

NODE_NAME: Final = "tacshade_bridge"
# Zenoh's receiving waits when this is full, until the next poll.
_CHANGES_MAX: Final = 1024
_INCOMING_BYTES_MAX: Final = 1 << 20


class RosPublisher:
    """A topic's publisher, seen in the graph until it is closed."""

    def __init__(self, session: zenoh.Session, node: RosNode, number: int, topic: RosTopic) -> None:
        self.key = topic.key(node.domain)
        token = node.publisher_token(number, topic)
        self._gid, self._sequence = gid_of(token), 0
        # Zenoh's stubs leave some methods without types.
        self._publisher: Any = (
            ext.declare_advanced_publisher(
                session,
                self.key,
                cache=ext.CacheConfig(topic.depth),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.DROP,
            )
            if topic.latched
            # What a full network cannot take is dropped, and the subscriber sees a gap.
            else session.declare_publisher(
                self.key, congestion_control=zenoh.CongestionControl.DROP
            )
        )
        self._token: Any = session.liveliness().declare_token(token)

    def put(self, payload: bytearray) -> None:
        """Send a message; never waits longer than 1 ms."""
        self._sequence += 1
        attached = attachment(self._sequence, time.time_ns(), self._gid)
        self._publisher.put(payload, attachment=attached)

    def close(self) -> None:
        self._token.undeclare()
        self._publisher.undeclare()


class RosSession:
    """The session, connected when it is made. Raises ConnectionError if no router answers.

    It reconnects by itself, with all its tokens. `poll`, `count` and `elsewhere` need one lock, as
    `Listeners` does.
    """

    def __init__(self, endpoint: str, domain: int) -> None:
        config = {
            "mode": "client",
            "connect": {"endpoints": [endpoint], "timeout_ms": 0},
            "scouting": {"multicast": {"enabled": False}},
            "transport": {
                # A pool of 9 MB and two threads, to save a copy of 50 kB.
                "shared_memory": {"enabled": False},
                # Only tokens and questions come in; Zenoh itself allows 1 GiB.
                "link": {"rx": {"max_message_size": _INCOMING_BYTES_MAX}},
            },
            # What a late subscriber of a latched topic gets is ordered by time.
            "timestamping": {"enabled": True},
        }
        try:
            self._session: Any = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        except zenoh.ZError:
            raise ConnectionError(f"{endpoint}: no Zenoh router answers") from None
        zid = str(self._session.info.zid())
        self._node, self._numbers = RosNode(domain, zid, NODE_NAME), 0
        liveliness = self._session.liveliness()
        self._listeners = Listeners(domain, zid)
        self._changes = liveliness.declare_subscriber(
            EVERYBODY, FifoChannel(_CHANGES_MAX), history=True
        )
        self._token = liveliness.declare_token(self._node.token())

    @property
    def connected(self) -> bool:
        """Whether a router answers now."""
        return bool(list(self._session.info.routers_zid()))

    def advertise(self, topic: RosTopic) -> RosPublisher:
        """Offer a topic until its publisher is closed."""
        self._numbers += 1
        return RosPublisher(self._session, self._node, self._numbers, topic)

    def poll(self) -> None:
        """Take note of the tokens that came and went."""
        while (change := self._changes.try_recv()) is not None:
            token = str(change.key_expr)
            if change.kind == zenoh.SampleKind.PUT:
                self._listeners.come(token)
            else:
                self._listeners.go(token)

    def count(self, publisher: RosPublisher) -> int:
        """How many subscriptions the publisher's topic has."""
        return self._listeners.count(publisher.key)

    def elsewhere(self) -> list[str]:
        """The domains in which others are, if none is in this one."""
        return self._listeners.elsewhere()

    def close(self) -> None:
        # zenoh's own `close` ends its threads; nothing is declared afterwards.
        self._session.close()
