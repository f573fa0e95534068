"""Publishing to the broker: it never blocks its caller, and its memory is bounded whatever the peer does.

paho's own queue is unbounded for QoS 0, so every topic has a `TopicSlot`: one waiting payload, the newest, and
at most two that paho holds and has not yet written.

Threads: the callers' and paho's network thread. `_lock` guards all state and is never held during a call to paho or to
a callback of ours, since paho calls back while it holds its own locks.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.devices.fixes import MESSAGE_SIZE_FIX, with_fix
from tacshade_edge.devices.mqtt.client import PACKET_TOO_LARGE, Session, packet_bytes, publish_properties
from tacshade_edge.devices.mqtt.topic_slot import Item, PayloadOutcome, TopicSlot
from tacshade_edge.protocol.requests import Request
from tacshade_edge.protocol.topics import OF_SENSORS
from tacshade_edge.reasons import Reason, ReasonCode

SMALL_BYTES: Final = 1024
"""No larger message is needed for a broker to end a connection for another reason."""
_AT_ONCE_NS: Final = 3_000_000_000
_FIRST_RETRY_NS, _LAST_RETRY_NS = 60_000_000_000, 3_600_000_000_000


@dataclass(slots=True)
class SizeLimit:
    """What is known of a broker's limit. Sizes are in bytes on the wire. It has no lock: its owner guards it.

    Some brokers announce a limit when a client connects. Others reject a larger message of QoS 1, silently drop one of
    QoS 0, or end the connection.

    `announced`: the largest packet according to the broker; None if it set no limit. `why`: how the limit showed, once
    a message was too large; empty before.
    """

    announced: int | None = None
    why: str = ""
    _learned: int | None = None
    _proven: int = 0
    _suspected: int = 0
    _retry_ns: int = 0
    _pause_ns: int = _FIRST_RETRY_NS
    _connected_ns: int = 0

    def connected(self, announced: int | None, now_ns: int) -> None:
        """Begin a connection: sizes are tried again, but a limit that was learned stays."""
        if announced != self.announced:
            self.why = ""
        self.announced, self._proven, self._connected_ns = announced, 0, now_ns

    def refuses(self, size: int, now_ns: int) -> bool:
        """Whether the broker would reject a message of `size`. After some minutes a learned limit is tried again."""
        if self._learned is not None and now_ns >= self._retry_ns:
            self._learned, self.why = None, ""
        if self._learned is not None and size > self._learned:
            return True
        if self.announced is None or size <= self.announced:
            return False
        self.why = self.why or f"accepts packets of at most {self.announced} bytes"
        return True

    def untried(self, size: int) -> bool:
        """Whether the broker has not yet acknowledged a message of this size, so it must be sent with QoS 1."""
        return size > self._proven

    def took(self, size: int) -> None:
        """Record an acknowledged message."""
        self._proven = max(self._proven, size)
        if size >= self._suspected:
            self._suspected = 0

    def rejected(self, size: int, now_ns: int) -> None:
        """Record a message that the broker called too large."""
        self._learn(size - 1, f"rejects a message of {size} bytes as too large", now_ns)

    def lost(self, sizes: Collection[int], said_so: bool, now_ns: int) -> None:
        """Record a lost connection, and the sizes of the messages that the broker had not acknowledged.

        The broker is at fault if it said so, or if a connection that followed ended like this at once.
        """
        size = max(sizes, default=0)
        if size <= max(self._proven, SMALL_BYTES):
            return
        if said_so or (self._suspected and now_ns - self._connected_ns < _AT_ONCE_NS):
            # Below this size, so that sizes that vary need few connections.
            self._learn(
                max(size * 3 // 4, self._proven), f"ends the connection after a message of {size} bytes", now_ns
            )
        self._suspected = size

    def _learn(self, largest: int, why: str, now_ns: int) -> None:
        if self._learned is None:
            self._retry_ns = now_ns + self._pause_ns
            self._pause_ns = min(2 * self._pause_ns, _LAST_RETRY_NS)
            self.why = why
        self._learned = largest if self._learned is None else min(self._learned, largest)


class Refusals:
    """The topics that are rejected now, logged once: that continues until somebody fixes the broker's rules.

    It has no lock: its owner guards it. `where`: name of the broker in the log.
    """

    def __init__(self, where: str) -> None:
        self._where = where
        self._topics: set[str] = set()

    def refused(self, topic: str, why: str) -> None:
        """Record a rejected message or subscription to a topic; log the first."""
        if not self._topics:
            _log.warning("%s: rejects %s: %s; further rejections are not logged", self._where, topic, why)
        self._topics.add(topic)

    def taken(self, topic: str) -> None:
        """Record an accepted one; log the end of all rejections."""
        if topic in self._topics:
            self._topics.remove(topic)
            if not self._topics:
                _log.info("%s: no longer rejects any topic", self._where)


_log = logging.getLogger(__name__)

_UNSENT_PER_STREAM: Final = 2
_ANSWERS_OPEN_MAX: Final = 16
_STREAM_EXPIRY_S: Final = 5  # the broker then drops what a stalled subscriber has not read
_NO_LISTENER: Final = 0x10  # "no matching subscribers", MQTT 5
_JSON: Final = "application/json"
CONTENT_TYPES: Final = {name: topic.content_type for name, topic in OF_SENSORS.items()}
_COUNTERS: Final = (
    *("connects", "losses", "published", "superseded", "failed", "refused"),
    *("requests", "bad_requests", "replies", "replies_dropped", "events", "events_dropped"),
)


class _Sent(NamedTuple):
    """A message that paho holds: the stream's or retained item, or None for a reply or an event; its size in bytes."""

    outlet: TopicSlot | None
    item: Item | None
    qos: int
    size: int


class Outgoing:
    """The payloads on their way to one broker. `client`: this object receives its answers. `where`: name of the broker
    in the log. `on_outcome`: receives (stream, seq, outcome) once per offered payload.
    """

    def __init__(
        self, client: Session, where: str, base_topic: str, on_outcome: Callable[[str, int, PayloadOutcome], None]
    ) -> None:
        self._client, self._where, self._base, self._on_outcome = client, where, base_topic, on_outcome
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._connected, self._stopping = False, False
        self._epoch = 0  # counts lost connections: items of an earlier one are already settled
        self._outlets: dict[str, TopicSlot] = {}
        self._by_mid: dict[int, _Sent] = {}
        self._early: dict[int, MqttCode] = {}  # answers that came before publish() returned their mid
        self._answers_open = 0
        self._refusals = Refusals(where)
        self._size_limit = SizeLimit()
        self._too_large: Reason | None = None
        self._counters: Counter[str] = Counter()
        client.answered(self._on_answer)

    @property
    def connected(self) -> bool:
        """Whether the broker has accepted us."""
        return self._connected

    @property
    def limited(self) -> Reason | None:
        """Why the broker gets no large messages; None while no message has exceeded its limit."""
        return self._too_large

    def counters(self) -> dict[str, int]:
        """Return the counts since the start, always of all names. `refused`: the broker denied it or its size."""
        with self._lock:
            counts = self._counters + Counter(bad_requests=self._client.refused)
            return {name: counts[name] for name in _COUNTERS}

    def set_retained(self, topic: str, payload: bytes, *, qos: Literal[0, 1] = 1) -> None:
        """Publish a retained value, now and again on every connection; the newest wins.

        The topic is relative to the base topic; with a leading slash it starts at the broker's root.
        """
        with self._lock:
            outlet = self._outlet(topic, qos, True)
            outlet.put(Item(payload, 0))
        self._pump(outlet)

    def has_listener(self, stream: str) -> bool:
        """Whether a stream may have a subscriber: False while the broker's latest answer reported none.

        Even then it is True once a second, so that the next payload probes again. It is always True while the broker
        is away, or if it never reports this (MQTT 5 leaves that to the broker).
        """
        with self._lock:
            outlet = self._outlets.get(stream)
            return outlet is None or not outlet.no_listener or outlet.probe_due(time.monotonic_ns())

    def offer(self, stream: str, payload: bytes, seq: int) -> None:
        """Send a payload of a stream (not retained) once the peer accepts it, unless a newer one comes first.

        QoS is 0, except for one probe a second with QoS 1, whose answer shows whether anyone listens (`has_listener`).

        Its one outcome: ``published`` (handed to the operating system), ``superseded`` (a newer one displaced it),
        ``refused`` (the broker denied it or, with QoS 0, the last one it answered; or it is too large), or
        ``failed`` (displaced or lost while the broker was away; before the first connection, ``superseded``). The
        newest payload is kept while the broker is away and is sent first afterwards, so that subscribers do not keep
        outdated data.
        """
        with self._lock:
            outlet = self._outlet(stream, 0, False)
            item = Item(payload, seq)
            displaced = item if self._stopping else outlet.put(item)
            outcome: PayloadOutcome = "superseded" if self._connected and not self._stopping else "failed"
        if displaced is not None:
            self._settle(outcome, [(stream, displaced)])
        self._pump(outlet)

    def reply(self, request: Request, payload: bytes) -> None:
        """Answer a request on ``res/<verb>`` or on its MQTT 5 response topic. Lost with the connection."""
        self._send_once("replies", request.response_topic or f"res/{request.verb}", payload, request.correlation)

    def publish_event(self, topic: str, payload: bytes) -> None:
        """Publish an event once, under the base topic (QoS 1, not retained). Lost with the connection, and counted."""
        self._send_once("events", topic, payload, None)

    def _path(self, topic: str) -> str:
        return topic[1:] if topic.startswith("/") else f"{self._base}/{topic}"

    def _outlet(self, topic: str, qos: int, retain: bool) -> TopicSlot:
        """Return the topic's outlet, created on first use. Lock held."""
        if topic not in self._outlets:
            content_type = CONTENT_TYPES.get(topic, _JSON)
            properties = publish_properties(content_type, expiry_s=None if retain else _STREAM_EXPIRY_S)
            most = 1 if retain else _UNSENT_PER_STREAM
            self._outlets[topic] = TopicSlot(topic, qos, retain, most, properties)
        return self._outlets[topic]

    def _pump(self, outlet: TopicSlot) -> None:
        """Hand paho the items it may send. One thread at a time per outlet; a second leaves the work to the first."""
        while True:
            with self._lock:
                item = outlet.take() if self._may_go(outlet) else None
                epoch = self._epoch
                if item is None:
                    return
                now_ns = time.monotonic_ns()
                size = packet_bytes(self._path(outlet.topic), item.payload, outlet.properties)
                if too_large := self._exceeds(outlet.topic, size, now_ns):
                    outlet.done(item)
                    outlet.busy = False
                    self._counters["refused"] += outlet.retain
                else:
                    qos = max(outlet.next_qos(now_ns), self._size_limit.untried(size))
            if too_large:
                if not outlet.retain:
                    self._settle("refused", [(outlet.topic, item)])
                continue
            info = self._client.publish(self._path(outlet.topic), item.payload, qos, outlet.retain, outlet.properties)
            settled: tuple[PayloadOutcome, Item] | None = None
            with self._lock:
                outlet.busy = False
                if epoch != self._epoch:
                    continue  # already settled when the connection was lost
                taken = info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS
                if not taken:  # the connection is failing; the next one pumps
                    failed = outlet.refuse(item)
                    settled = None if failed is None else ("failed", failed)
                elif (code := self._early.pop(info.mid, None)) is not None:
                    settled = (self._done(outlet, item, qos, size, code), item)
                else:
                    self._by_mid[info.mid] = _Sent(outlet, item, qos, size)
            if settled is not None:
                self._settled(outlet, *settled)
            if not taken:
                return

    def _may_go(self, outlet: TopicSlot) -> bool:
        """Whether paho may get more items of a topic. Lock held.

        The state goes first, and the rest once the broker has answered it: otherwise frames that access rules deny
        would count as published until the answer.
        """
        state = self._outlets["state"]
        return self._connected and not self._stopping and (outlet is state or state.refused is not None)

    def _settled(self, outlet: TopicSlot, outcome: PayloadOutcome, item: Item) -> None:
        """Report the outcome of an item that paho held. Lock not held."""
        if not outlet.retain:
            self._settle(outcome, [(outlet.topic, item)])
        elif outlet.topic == "state":
            with self._lock:
                others = sorted((o for o in self._outlets.values() if o is not outlet), key=lambda o: not o.retain)
            for other in others:
                self._pump(other)

    def _send_once(self, kind: str, topic: str, payload: bytes, correlation: bytes | None) -> None:
        """Publish a reply or an event (QoS 1).

        It is dropped if not connected, if too large, or if 16 are still unacknowledged.
        """
        properties = publish_properties(_JSON, correlation=correlation)
        size = packet_bytes(self._path(topic), payload, properties)
        with self._lock:
            too_large = self._exceeds(topic, size, time.monotonic_ns())
            if too_large or not self._connected or self._answers_open >= _ANSWERS_OPEN_MAX:
                self._counters[f"{kind}_dropped"] += 1
                self._counters["refused"] += too_large
                return
            self._answers_open += 1
            self._counters[kind] += 1
            epoch = self._epoch
        info = self._client.publish(self._path(topic), payload, 1, False, properties)
        with self._lock:
            if epoch != self._epoch:
                return
            if info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
                self._answers_open -= 1
            elif (code := self._early.pop(info.mid, None)) is not None:
                self._answered(size, code)
            else:
                self._by_mid[info.mid] = _Sent(None, None, 1, size)

    def _answered(self, size: int, code: MqttCode) -> None:
        """Record the broker's answer to a reply or an event. Lock held."""
        self._answers_open -= 1
        self._note("res or event", size, code)
        self._counters["refused"] += code.is_failure

    def _done(self, outlet: TopicSlot, item: Item, qos: int, size: int, code: MqttCode) -> PayloadOutcome:
        """Record that paho sent an item (QoS 0) or the broker answered it (QoS 1); return its outcome. Lock held."""
        outlet.done(item)
        self._changed.notify_all()
        if qos == 1:
            self._note(outlet.topic, size, code)
            self._counters["refused"] += outlet.retain and code.is_failure
            if code.value == PACKET_TOO_LARGE:  # which says nothing about the topic
                outlet.refused = bool(outlet.refused)
                return "refused"
            outlet.no_listener = code.value == _NO_LISTENER
            outlet.refused = code.is_failure
        # QoS 0 has no answer: rules that deny the state, or this stream's latest probe, deny this item too.
        refused = self._outlets["state"].refused if outlet.refused is None else outlet.refused
        return "refused" if refused else "published"

    def _note(self, topic: str, size: int, code: MqttCode) -> None:
        """Record whether the broker accepts a message, and so its size and its topic. Lock held."""
        if code.value == PACKET_TOO_LARGE:
            now_ns = time.monotonic_ns()
            self._size_limit.rejected(size, now_ns)
            self._exceeds(topic, size, now_ns)
            return
        self._size_limit.took(size)
        if code.is_failure:
            which = self._path(topic) if topic.startswith("/") else f"{self._base}/#"
            expected = f"expected access rules (ACL) that allow this user to publish to {which}"
            self._refusals.refused(self._path(topic), f"{code}, {expected}")
        else:
            self._refusals.taken(self._path(topic))

    def _exceeds(self, topic: str, size: int, now_ns: int) -> bool:
        """Whether a message is larger than the broker accepts. Lock held."""
        exceeds = self._size_limit.refuses(size, now_ns)
        why = self._size_limit.why
        if exceeds and self._too_large is None:
            skipped = f"so this client skips {self._path(topic)} of {size} bytes, and other large messages"
            self._too_large = Reason(ReasonCode.MESSAGE_SIZE_LIMIT, f"{self._where}: {why}, {skipped}")
            _log.warning("%s", with_fix(self._too_large, MESSAGE_SIZE_FIX))
        elif not why:
            self._too_large = None
        return exceeds

    def _settle(self, outcome: PayloadOutcome, items: list[tuple[str, Item]]) -> None:
        """Report the outcome of stream items. Lock not held."""
        with self._lock:
            if outcome == "failed" and not self._counters["connects"]:
                outcome = "superseded"  # no broker has been there yet
            self._counters[outcome] += len(items)
        for stream, item in items:
            self._on_outcome(stream, item.seq, outcome)

    def _forget(self, code: int | None) -> list[tuple[str, Item]]:
        """Forget the connection, which the broker ended with `code`; return the stream items that failed. Lock held."""
        if self._connected and not self._stopping:
            unanswered = [sent.size for sent in self._by_mid.values() if sent.qos == 1]
            self._size_limit.lost(unanswered, code == PACKET_TOO_LARGE, time.monotonic_ns())
        self._counters["losses"] += self._connected and not self._stopping
        self._connected = False
        self._epoch += 1
        self._by_mid.clear()
        self._early.clear()
        self._answers_open = 0
        self._changed.notify_all()
        return [(o.topic, item) for o in self._outlets.values() for item in o.give_back()]

    def _on_answer(self, mid: int, code: MqttCode) -> None:
        with self._lock:
            if mid not in self._by_mid:
                self._early[mid] = code
                return
            outlet, item, qos, size = self._by_mid.pop(mid)
            if outlet is None or item is None:
                self._answered(size, code)
                return
            outcome = self._done(outlet, item, qos, size, code)
        self._settled(outlet, outcome, item)
        self._pump(outlet)
