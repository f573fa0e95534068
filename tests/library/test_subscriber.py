"""listen: a real broker; what cannot be heard is an error that says why,
and the next call begins again.
"""

from __future__ import annotations

import os
import threading
from pathlib import Path

import pytest

import tacshade_edge as ts
from support.mqtt_rig import Broker, free_port
from support.patience import patience, wait_until
from support.published_sensor import PublishedSensor, bump
from tacshade_edge.library import subscriber
from tacshade_edge.library.frame_assembler import FrameAssembler
from tacshade_edge.reasons import Reason, ReasonCode

pytestmark = pytest.mark.broker


def test_an_absent_broker_is_reported() -> None:
    with pytest.raises(
        ts.DeviceError,
        match="Connection refused; expected a broker that serves topics under tacshade/drawn/",
    ):
        ts.listen(f"127.0.0.1:{free_port()}", "drawn")


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_the_newest_wins_and_its_thread_ends_with_it(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, PublishedSensor(broker.port) as hand:
        before, files = set(threading.enumerate()), open_files()
        with ts.listen(f"127.0.0.1:{broker.port}", "drawn") as results:
            hand.show(bump(1, 2.0, 230, 320, 4))
            first = next(results)
            for seq in range(2, 10):
                hand.show(bump(seq, 2.0, 230, 320, 4))
            hand.show(bump(10, 0.0, 230, 320, 4))
            last = first
            while last.seq < 10:
                last = next(results)
            assert (first.seq, first.in_contact, last.in_contact) == (1, True, False)
        assert next(results, None) is None
        # One of the broker's or the hand's may have ended.
        assert set(threading.enumerate()) <= before
        assert open_files() <= files


def test_a_broker_that_went_is_reported_and_found_again(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, ts.listen(f"127.0.0.1:{broker.port}", "drawn") as results:
        broker.stop()
        with pytest.raises(ts.DeviceError, match="connection lost"):
            next(results)
        with pytest.raises(ts.DeviceError, match="Connection refused"):
            next(results)
        broker.start()
        ended = threading.Event()
        with PublishedSensor(broker.port) as hand:

            def show() -> None:
                while not ended.wait(0.02):
                    hand.show(bump(1, 2.0, 230, 320, 8))

            showing = threading.Thread(target=show)
            showing.start()
            try:
                assert next(results).in_contact
            finally:
                ended.set()
                showing.join()


def test_a_connection_that_comes_back_while_nobody_reads_is_no_error(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    with Broker(tmp_path) as broker, ts.listen(f"127.0.0.1:{broker.port}", "drawn") as results:
        broker.stop()
        wait_until(lambda: "connection lost" in caplog.text, 10, "the loss")
        broker.start()
        wait_until(lambda: "connected again" in caplog.text, 10, "the return")
        with PublishedSensor(broker.port) as hand:
            hand.show(bump(1, 2.0, 230, 320, 8))
            assert next(results).in_contact


def test_a_dead_thread_raises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        Broker(tmp_path) as broker,
        PublishedSensor(broker.port) as hand,
        ts.listen(f"127.0.0.1:{broker.port}", "drawn") as results,
    ):
        monkeypatch.delattr(FrameAssembler, "add")  # a defect of ours
        hand.show(bump(1, 2.0, 230, 320, 8))
        with pytest.raises(ts.DeviceError, match="receiving ended"):
            next(results)


def test_close_ends_a_loop_in_another_thread(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker:
        results = ts.listen(f"127.0.0.1:{broker.port}", "drawn")
        got: list[ts.Result] = []
        reader = threading.Thread(target=lambda: got.extend(results))
        reader.start()
        results.close()
        reader.join(patience(10))
        assert not reader.is_alive()
        assert got == []


def test_silence_says_what_is_known(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscriber, "_SILENT_S", 1.0)
    with Broker(tmp_path) as broker, PublishedSensor(broker.port) as hand:
        missing = Reason(ReasonCode.NOT_CALIBRATED, "not calibrated: found no file")
        hand.publish_info("fast", profiles=("fast",), missing=missing)
        with ts.listen(f"127.0.0.1:{broker.port}", "drawn") as results:
            said = (
                "tacshade/drawn: no result for 1 s; the sensor's state is online; not calibrated: "
                "found no file"
            )
            with pytest.raises(ts.DeviceError, match=said):
                next(results)
        with (
            ts.listen(f"127.0.0.1:{broker.port}", "nobody") as results,
            pytest.raises(ts.DeviceError, match="no daemon has published a state"),
        ):
            next(results)


def test_a_broker_that_does_not_let_us_in_is_reported(tmp_path: Path) -> None:
    with Broker(tmp_path, users={"dashboard": "word"}) as broker:
        where = f"127.0.0.1:{broker.port}"
        with pytest.raises(ts.DeviceError, match="rejects the connection: Not authorized"):
            ts.listen(where, "drawn", username="dashboard", password="wrong")
        ts.listen(where, "drawn", username="dashboard", password="word").close()
