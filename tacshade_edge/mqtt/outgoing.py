"""Publishing: it never blocks its caller, and its memory is bounded whatever the broker does.

paho's own queue is unbounded for QoS 0, so every topic has a slot: one waiting payload, the newest,
and at most two that paho holds and has not yet written.

Threads: the callers' and paho's network thread. Whatever changes the state is a call in one queue,
which one thread at a time executes, so they need no lock. No thread waits for another's turn: paho
calls back while it holds its own locks.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Final, Literal

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.reasoncodes import ReasonCode as MqttCode

from tacshade_edge.fixes import MESSAGE_SIZE_FIX, with_fix
from tacshade_edge.mqtt.packets import PACKET_TOO_LARGE, packet_bytes, publish_properties
from tacshade_edge.mqtt.slots import Item, Sent, Slot
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.wire.topics import OF_SENSORS

_log = logging.getLogger(__name__)

PayloadOutcome = Literal["published", "superseded", "failed", "refused"]

# One that the socket is taking, and one that follows without a pause; a third would only be an
# older frame in paho's queue.
_UNSENT_PER_STREAM: Final = 2
# A broker that acknowledges nothing must not make us keep every answer and event.
_ANSWERS_OPEN_MAX: Final = 16
# The broker then drops what a stalled subscriber has not read.
_STREAM_EXPIRY_S: Final = 5
_NO_LISTENER: Final = 0x10  # "no matching subscribers", MQTT 5
_JSON: Final = "application/json"
CONTENT_TYPES: Final = {name: topic.content_type for name, topic in OF_SENSORS.items()}
_COUNTERS: Final = (
    "connects",
    "losses",
    "published",
    "superseded",
    "failed",
    "refused",
    "requests",
    "bad_requests",
    "replies",
    "replies_dropped",
    "events",
    "events_dropped",
)


class Outgoing:
    """The payloads on their way to one broker.

    `where`: name of the broker in the log. `on_outcome`: receives (stream, seq, outcome) once per
    offered payload, in the thread whose turn it is.
    """

    def __init__(
        self,
        client: Client,
        where: str,
        base_topic: str,
        on_outcome: Callable[[str, int, PayloadOutcome], None],
    ) -> None:
        self._client, self._where, self._base = client, where, base_topic
        self._on_outcome = on_outcome
        self._calls: deque[Callable[[], None]] = deque()
        self._turn = threading.Lock()
        self._away = threading.Event()
        self._away.set()
        self._last_state_sent = threading.Event()  # or the connection was lost
        self._ending = self._stopping = False
        self._slots: dict[str, Slot] = {}
        self._by_mid: dict[int, Sent] = {}
        self._denied: set[str] = set()
        # The largest packet that the broker accepts and how that showed,
        # and the largest that it has acknowledged.
        self._bytes_max: int | None = None
        self._bytes_max_why = ""
        self._bytes_proven = 0
        self._too_large: Reason | None = None
        self._counters = Counter(dict.fromkeys(_COUNTERS, 0))

    @property
    def connected(self) -> bool:
        """Whether the broker has accepted us."""
        return not self._away.is_set()

    @property
    def limited(self) -> Reason | None:
        """Why the broker gets no large messages; None while no message
        of this connection has exceeded its limit.
        """
        return self._too_large

    @property
    def stopping(self) -> bool:
        """Whether `finish` was called: nothing is sent any more."""
        return self._stopping

    def counters(self) -> dict[str, int]:
        """Return the counts since the start, always of all names.

        `refused`: the broker denied it or its size.
        """
        return dict(self._counters)

    def set_retained(self, topic: str, payload: bytes | None, *, qos: Literal[0, 1] = 1) -> None:
        """Publish a retained value (None: the newest), and again on every connection.

        The topic is relative to the base topic; with a leading slash it starts at the broker's
        root.
        """
        self.post(lambda: self._retain(topic, payload, qos))

    def has_listener(self, stream: str) -> bool:
        """Whether a stream may have a subscriber: False
        while the broker's latest answer reported none.

        Even then it is True once a second, so that the next payload probes again. It is always True
        while the broker is away, or if it never reports this (MQTT 5 leaves that to the broker).
        """
        slot = self._slots.get(stream)
        return slot is None or not slot.no_listener or slot.probe_due(time.monotonic_ns())

    def offer(self, stream: str, payload: bytes, seq: int) -> None:
        """Send a payload of a stream (not retained) once the peer accepts it,
        unless a newer one comes first.

        QoS is 0, except for one probe a second with QoS 1, whose answer shows whether anyone
        listens (`has_listener`).

        Its one outcome: ``published`` (handed to the operating system), ``superseded`` (a newer one
        displaced it), ``refused`` (the broker denied it or, with QoS 0, the last one it answered;
        or it is too large), or ``failed`` (displaced or lost while the broker was away; before the
        first connection, ``superseded``). The newest payload is kept while the broker is away and
        is sent first afterwards, so that subscribers do not keep outdated data.
        """

        def put() -> None:
            slot, item = self._slot(stream, 0, retain=False), Item(payload, seq)
            displaced, slot.waiting = (item, None) if self._stopping else (slot.waiting, item)
            if displaced is not None:
                self._settle(
                    "superseded" if self.connected and not self._stopping else "failed",
                    slot,
                    displaced,
                )
            self._pump(slot)

        self.post(put)

    def send_once(self, kind: str, topic: str, payload: bytes, correlation: bytes | None) -> None:
        """Publish a reply or an event (QoS 1).

        It is dropped if not connected, if too large, or if 16 are still unacknowledged.
        """
        properties = publish_properties(_JSON, correlation=correlation)
        size = packet_bytes(self._path(topic), payload, properties)

        def send() -> None:
            too_large = self._exceeds(topic, size)
            # Streams are bounded by their slots; these have none.
            open_now = sum(sent.slot is None for sent in self._by_mid.values())
            if too_large or not self.connected or open_now >= _ANSWERS_OPEN_MAX:
                self._counters[f"{kind}_dropped"] += 1
                self._counters["refused"] += too_large
                return
            self._counters[kind] += 1
            info = self._client.publish(self._path(topic), payload, 1, properties=properties)
            if info.rc == MQTTErrorCode.MQTT_ERR_SUCCESS:
                self._by_mid[info.mid] = Sent(None, None, 1, size)

        self.post(send)

    def post(self, call: Callable[[], None]) -> None:
        """Execute a call after those already posted;
        at once, unless another thread is executing them.
        """
        self._calls.append(call)
        # Whoever has the turn executes this call too, so nobody waits. Asked again after the
        # release: a call may have come between the last one and that.
        while self._calls and self._turn.acquire(blocking=False):
            try:
                while self._calls:
                    self._calls.popleft()()
            finally:
                self._turn.release()

    def finish(self, state: bytes, timeout_s: float) -> None:
        """Send what waits and this last ``state``; wait for its answer, but only so long.

        From then on nothing is sent, and every payload offered fails.
        """
        self._last_state_sent.clear()
        self.post(lambda: self._end(state))
        if self.connected:
            self._last_state_sent.wait(timeout_s)
        self._stopping = True

    def wait_until_away(self, timeout_s: float) -> None:
        """Wait until the connection is lost, but only so long."""
        self._away.wait(timeout_s)

    # -- executed in turn --------------------------------------------------------------------------

    def _path(self, topic: str) -> str:
        return topic[1:] if topic.startswith("/") else f"{self._base}/{topic}"

    def _slot(self, topic: str, qos: int, *, retain: bool) -> Slot:
        if topic not in self._slots:
            content_type = CONTENT_TYPES.get(topic, _JSON)
            properties = publish_properties(
                content_type, expiry_s=None if retain else _STREAM_EXPIRY_S
            )
            self._slots[topic] = Slot(
                topic, qos, retain, 1 if retain else _UNSENT_PER_STREAM, properties
            )
        return self._slots[topic]

    def _pump(self, slot: Slot) -> None:
        """Hand paho the items of a slot that it may send.

        The state goes first, and the rest once the broker has answered it: otherwise frames that
        access rules deny would count as published until the answer.
        """
        state = self._slots["state"]
        while (item := slot.waiting) is not None and len(slot.handed) < slot.most:
            if (
                not self.connected
                or self._stopping
                or (slot is not state and state.refused is None)
            ):
                return
            slot.waiting = None
            size = packet_bytes(self._path(slot.topic), item.payload, slot.properties)
            if self._exceeds(slot.topic, size):
                self._settle("refused", slot, item)
                continue
            # Only an answer shows whether a broker takes a message of a size that it has not taken
            # yet; QoS 0 has none.
            qos = max(slot.next_qos(time.monotonic_ns()), size > self._bytes_proven)
            info = self._client.publish(
                self._path(slot.topic),
                item.payload,
                qos,
                retain=slot.retain,
                properties=slot.properties,
            )
            if (
                info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS
            ):  # the connection is failing; the next one pumps
                slot.waiting = item
                return
            slot.handed.append(item)
            self._by_mid[info.mid] = Sent(slot, item, qos, size)

    def answered(self, mid: int, code: MqttCode) -> None:
        """Record that paho sent a message (QoS 0) or the broker answered it (QoS 1)."""
        if mid not in self._by_mid:
            return  # of an earlier connection
        slot, item, qos, size = self._by_mid.pop(mid)
        if slot is None or item is None:
            self.note("res or event", size, code)
            self._counters["refused"] += code.is_failure
            return
        # Not always the first: the broker answers QoS 1 after paho has sent a later one of QoS 0.
        slot.handed.remove(item)
        too_large = code.value == PACKET_TOO_LARGE
        if qos == 1:
            self.note(slot.topic, size, code)
            if too_large:  # which says nothing about the topic
                slot.refused = bool(slot.refused)
            else:
                slot.no_listener, slot.refused = code.value == _NO_LISTENER, code.is_failure
        state = self._slots["state"]
        # QoS 0 has no answer: rules that deny the state, or this stream's latest probe,
        # deny this item too.
        denied = (
            code.is_failure
            if slot.retain
            else state.refused
            if slot.refused is None
            else slot.refused
        )
        self._settle("refused" if too_large or denied else "published", slot, item)
        if slot is state:
            for other in sorted(self._slots.values(), key=lambda o: (o is state, not o.retain)):
                self._pump(other)
        self._pump(slot)
        if self._ending and not state.handed:
            self._last_state_sent.set()

    def note(self, topic: str, size: int, code: MqttCode) -> None:
        """Record whether the broker accepts a message, and so its size and its topic."""
        path = self._path(topic)
        if code.value == PACKET_TOO_LARGE:
            self._bytes_max = size - 1
            self._bytes_max_why = f"rejects a message of {size} bytes as too large"
            self._exceeds(topic, size)
            return
        self._bytes_proven = max(self._bytes_proven, size)
        if code.is_failure:
            if not self._denied:
                which = path if topic.startswith("/") else f"{self._base}/#"
                expected = f"expected access rules (ACL) that allow this user to publish to {which}"
                more = "further rejections are not logged"
                _log.warning("%s: rejects %s: %s, %s; %s", self._where, path, code, expected, more)
            self._denied.add(path)
        elif path in self._denied:
            self._denied.remove(path)
            if not self._denied:
                _log.info("%s: no longer rejects any topic", self._where)

    def _exceeds(self, topic: str, size: int) -> bool:
        """Whether a message is larger than the broker accepts; log the first of a connection."""
        if self._bytes_max is None or size <= self._bytes_max:
            return False
        if self._too_large is None:
            skipped = (
                f"so this client skips {self._path(topic)} of {size} bytes, "
                "and other large messages"
            )
            text = f"{self._where}: {self._bytes_max_why}, {skipped}"
            self._too_large = Reason(ReasonCode.MESSAGE_SIZE_LIMIT, text)
            _log.warning("%s", with_fix(self._too_large, MESSAGE_SIZE_FIX))
        return True

    def _settle(self, outcome: PayloadOutcome, slot: Slot, item: Item) -> None:
        """Report the outcome of an item; of retained ones only refusals are counted."""
        if slot.retain:
            self._counters["refused"] += outcome == "refused"
            return
        if outcome == "failed" and not self._counters["connects"]:
            outcome = "superseded"  # no broker has been there yet
        self._counters[outcome] += 1
        self._on_outcome(slot.topic, item.seq, outcome)

    def count(self, kind: str) -> None:
        """Count what is not a payload of ours, such as a request."""
        self._counters[kind] += 1

    def accepted(self, bytes_max: int | None) -> None:
        """Begin a connection to a broker that accepts packets of this size; None is any."""
        # Before anything is settled: until the first connection no payload counts as failed.
        self._counters["connects"] += 1
        self._bytes_max, self._bytes_max_why = (
            bytes_max,
            f"accepts packets of at most {bytes_max} bytes",
        )
        # Of this connection: a broker may come back with other limits.
        self._bytes_proven, self._too_large = 0, None
        self._away.clear()
        self._pump(self._slots["state"])

    def lost(self) -> None:
        """Forget the connection, if there is one."""
        if self.connected:
            self._counters["losses"] += not self._stopping
            self._by_mid.clear()
            for slot in self._slots.values():
                for item in slot.disconnected():
                    self._settle("failed", slot, item)
            self._away.set()
            self._last_state_sent.set()

    def give_up(self) -> None:
        """Forget the connection, and settle what waits for another one."""
        self.lost()
        for slot in self._slots.values():
            if not slot.retain and slot.waiting is not None:
                self._settle("failed", slot, slot.waiting)
                slot.waiting = None

    def _retain(self, topic: str, payload: bytes | None, qos: Literal[0, 1]) -> None:
        slot = self._slot(topic, qos, retain=True)
        slot.newest = slot.newest if payload is None else Item(payload, 0)
        slot.waiting = slot.newest
        self._pump(slot)

    def _end(self, state: bytes) -> None:
        """Send the last payload of each stream, however many paho holds, and the last state.

        In one turn: an answer to a frame between the two would end the wait for the state's.
        """
        for slot in self._slots.values():
            if not slot.retain:
                slot.most += 1
                self._pump(slot)
        self._retain("state", state, 1)
        self._ending = True
