"""The latest-wins slot under any order of events."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from tacshade_edge.devices.mqtt.topic_slot import PROBE_PERIOD_NS, Item, TopicSlot

EVENTS = st.lists(st.sampled_from(["put", "take", "sent", "refuse", "lost"]), max_size=60)


def make_outlet(*, retain: bool = False) -> TopicSlot:
    return TopicSlot("height", 0, retain, 1 if retain else 2, Properties(PacketTypes.PUBLISH))


@given(EVENTS)
def test_every_item_of_a_stream_has_one_fate_and_the_newest_is_never_lost(events: list[str]) -> None:
    outlet = make_outlet()
    fates: Counter[int] = Counter()
    sent: list[int] = []
    offered = 0
    for event in events:
        if event == "put":
            displaced = outlet.put(Item(b"", offered))
            offered += 1
            fates.update([displaced.seq] if displaced else [])
        elif event == "take" and (item := outlet.take()) is not None:
            outlet.busy = False
        elif event == "sent" and outlet.handed:
            item = outlet.handed[0]
            outlet.done(item)
            sent.append(item.seq)
            fates[item.seq] += 1
        elif event == "refuse" and outlet.handed:
            failed = outlet.refuse(outlet.handed[-1])
            fates.update([failed.seq] if failed else [])
        elif event == "lost":
            fates.update(i.seq for i in outlet.give_back())
        assert len(outlet.handed) <= 2
        newest_is_sent = bool(sent) and sent[-1] == offered - 1
        here = [i.seq for i in [*outlet.handed, *([outlet.waiting] if outlet.waiting else [])]]
        assert offered == 0 or newest_is_sent or offered - 1 in here
    fates.update(i.seq for i in outlet.drain())
    assert outlet.idle
    assert fates == Counter(range(offered))
    assert sent == sorted(sent)


def test_two_threads_cannot_publish_one_topic_at_once() -> None:
    outlet = make_outlet()
    outlet.put(Item(b"1", 1))
    assert outlet.take() is not None
    outlet.put(Item(b"2", 2))
    assert outlet.take() is None
    outlet.busy = False
    assert outlet.take() is not None


def test_retained_value_waits_again_after_every_loss() -> None:
    outlet = make_outlet(retain=True)
    outlet.put(Item(b"old", 0))
    outlet.put(Item(b"new", 0))
    for _ in range(3):
        item = outlet.take()
        assert item is not None
        assert item.payload == b"new"
        outlet.busy = False
        outlet.done(item)
        assert outlet.idle
        assert outlet.give_back() == []


def test_a_stream_asks_for_listeners_once_a_period_and_after_every_loss() -> None:
    outlet = make_outlet()
    asked = [outlet.next_qos(t_ns) for t_ns in (5, 6, PROBE_PERIOD_NS - 1, PROBE_PERIOD_NS + 5, PROBE_PERIOD_NS + 6)]
    assert asked == [1, 0, 0, 1, 0]
    outlet.no_listener = True
    assert outlet.next_qos(PROBE_PERIOD_NS + 7) == 0
    assert outlet.no_listener
    assert outlet.next_qos(2 * PROBE_PERIOD_NS + 5) == 1
    assert outlet.no_listener  # until another answer comes: else the next frame is reconstructed for nobody
    outlet.give_back()
    assert (outlet.no_listener, outlet.next_qos(2 * PROBE_PERIOD_NS + 6)) == (False, 1)


def test_streams_that_were_sent_one_after_the_other_ask_together() -> None:
    one, other = make_outlet(), make_outlet()
    assert [one.next_qos(5), other.next_qos(PROBE_PERIOD_NS - 5)] == [1, 1]
    assert not one.probe_due(PROBE_PERIOD_NS - 1)
    assert one.probe_due(PROBE_PERIOD_NS)
    assert other.probe_due(PROBE_PERIOD_NS)


def test_a_retained_value_keeps_its_qos() -> None:
    outlet = make_outlet(retain=True)
    assert [outlet.next_qos(t_ns) for t_ns in (5, 2 * PROBE_PERIOD_NS)] == [0, 0]
