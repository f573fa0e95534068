"""The link while its broker is away or takes nothing."""

from __future__ import annotations

import threading
import tracemalloc
from pathlib import Path

import pytest

from support.link_rig import (
    BACK_S,
    BASE,
    Rig,
    code,
    come_back,
    numbers,
    offer_for,
)
from support.mqtt_rig import Broker, Subscriber, free_port
from support.patience import promised, stretched, wait_until
from tacshade_edge.reasons import ReasonCode

DESCRIPTORS = Path("/proc/self/fd")


def test_a_stopped_link_keeps_no_descriptor_open() -> None:
    before = set(DESCRIPTORS.iterdir())
    rig = Rig(free_port())
    rig.link.start()
    wait_until(lambda: code(rig) is ReasonCode.UNREACHABLE, 3, "a reason")
    rig.link.stop(2)
    assert set(DESCRIPTORS.iterdir()) <= before


@pytest.mark.broker
class TestAway:
    def test_absent_at_start_then_there_then_restarted(self, tmp_path: Path) -> None:
        broker = Broker(tmp_path)
        rig = Rig(broker.port)
        rig.link.set_retained("info", b"{}")
        rig.link.start()
        offered = offer_for(rig, 0.5)
        wait_until(lambda: code(rig) is ReasonCode.UNREACHABLE, 3, "a reason")
        assert not rig.link.connected
        assert rig.counts("height") == {"superseded": offered - 1}  # the newest waits
        for seq in (1_000, 2_000):
            with broker, Subscriber(broker.port, f"{BASE}/#") as subscriber:
                come_back(rig, subscriber, seq)
                assert rig.link.reason is None
                subscriber.wait_for_last(f"{BASE}/state", b"online")
                subscriber.wait_for_last(f"{BASE}/info", b"{}")
            wait_until(lambda: not rig.link.connected, 3, "the loss is seen")
            assert str(broker.port) in str(rig.link.reason)
            assert code(rig) in (ReasonCode.LOST, ReasonCode.UNREACHABLE)
        assert rig.link.counters()["connects"] == rig.link.counters()["losses"] == 2
        rig.link.stop(2)

    def test_newest_frame_offered_while_away_goes_out_first(self, tmp_path: Path) -> None:
        broker = Broker(tmp_path)
        rig = Rig(broker.port)
        rig.link.start()
        for seq in range(10):
            rig.link.offer("height", seq.to_bytes(4, "big"), seq)
        with broker, Subscriber(broker.port, f"{BASE}/height") as subscriber:
            promised(lambda: rig.link.connected, BACK_S, "connected")
            subscriber.wait_for(f"{BASE}/height")
            assert numbers(subscriber) == [9]
            rig.link.stop(2)
        assert rig.outcomes["height"] == [(s, "superseded") for s in range(9)] + [(9, "published")]

    def test_undelivered_retained_value_does_not_come_back_over_a_newer_one(
        self, rig: Rig, broker: Broker
    ) -> None:
        broker.stall()
        rig.link.set_retained("status/camera", b"old")  # sent, never acknowledged
        broker.kill()
        wait_until(lambda: not rig.link.connected, 3, "the loss is seen")
        rig.link.set_retained("status/camera", b"new")
        broker.start()
        promised(lambda: rig.link.connected, BACK_S, "connected")
        with Subscriber(broker.port, f"{BASE}/#") as late:
            rig.link.offer(
                "contact", b"{}", 0
            )  # behind everything that the new connection began with
            late.wait_for(f"{BASE}/contact")
            assert set(late.of(f"{BASE}/status/camera")) == {b"new"}

    def test_stop_without_a_broker_ends_in_time(self) -> None:
        rig = Rig(free_port())
        rig.link.start()
        rig.link.offer("height", b"x", 0)
        stopped = threading.Event()
        threading.Thread(target=lambda: (rig.link.stop(1.5), stopped.set())).start()
        assert stopped.wait(1.5 + stretched(0.5))
        assert rig.outcomes["height"] == [(0, "superseded")], (
            "no broker has been there yet: nothing failed"
        )


@pytest.mark.broker
class TestStalled:
    @pytest.mark.slow
    def test_a_broker_that_takes_nothing_for_longer_than_two_keepalives(
        self, rig: Rig, broker: Broker, subscriber: Subscriber
    ) -> None:
        """As many frames as in a minute, and a flapping status:
        bounded, accounted for, back in 3 s.
        """
        seconds, fps = 22, 164
        offered = offer_for(rig, 0.2)
        subscriber.wait_for(f"{BASE}/height")
        broker.stall()
        tracemalloc.start()
        try:
            for _ in range(seconds):
                for n in range(500):
                    rig.link.set_retained("status/camera", f"{n}".encode() + bytes(1000))
                offered += offer_for(rig, 1.0, fps, first=offered)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 2_000_000, f"{peak} bytes for {offered * 38_000} offered"
        rig.link.set_retained("status/camera", b"last")
        counts = rig.counts("height")
        assert offered - 3 <= counts.total() <= offered - 1
        assert counts["superseded"] + counts["failed"] > 0.3 * seconds * fps
        broker.resume()
        come_back(rig, subscriber, offered)
        promised(
            lambda: subscriber.of(f"{BASE}/status/camera")[-1:] == [b"last"],
            BACK_S,
            "the newest status",
        )
        promised(lambda: subscriber.of(f"{BASE}/state")[-1:] == [b"online"], BACK_S, "online again")
        seen = numbers(subscriber)
        assert seen == sorted(set(seen))
        rig.link.stop(2)
        settled = sorted(seq for seq, _ in rig.outcomes["height"])
        assert settled == list(range(settled[-1] + 1))
        assert settled[-1] >= offered

    def test_short_stall_ends_with_the_newest_frame(
        self, rig: Rig, broker: Broker, subscriber: Subscriber
    ) -> None:
        broker.stall()
        last = offer_for(rig, 1.0, fps=100, size=200_000)
        rig.link.offer("height", last.to_bytes(4, "big"), last)
        broker.resume()
        promised(lambda: numbers(subscriber)[-1:] == [last], BACK_S, "the last frame, last")
        promised(
            lambda: rig.outcomes["height"][-1:] == [(last, "published")], BACK_S, "its outcome"
        )
        counts = rig.counts("height")
        assert counts["superseded"] > 0
        assert counts.total() == last + 1

    def test_stop_ends_in_time_and_the_will_speaks(
        self, broker: Broker, subscriber: Subscriber
    ) -> None:
        rig = Rig(broker.port).connect()
        subscriber.wait_for(f"{BASE}/state")
        broker.stall()
        # More than the kernel takes for a broker that does not read:
        # else it may find "stopped" there when it is back.
        offered = offer_for(rig, 0.1, fps=60, size=32_000_000)
        stopped = threading.Event()
        threading.Thread(target=lambda: (rig.link.stop(1.5), stopped.set())).start()
        assert stopped.wait(1.5 + stretched(0.5))
        assert rig.counts("height").total() == offered
        assert rig.counts("height")["failed"] >= 1
        broker.resume()
        subscriber.wait_for_last(f"{BASE}/state", b"offline")
