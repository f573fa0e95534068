"""The threads that frames pass through, and the mailbox between them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from support.patience import patience
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.pipeline.ledger import FrameLedger, FrameOutcome, Timings
from tacshade_edge.pipeline.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.pipeline.pipeline import (
    LOOK_EVERY,
    Crash,
    Grab,
    Mailbox,
    Pipeline,
    Reconstruct,
    crashes_to,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import Calibration, Frame, Need, Reconstruction


@given(st.lists(st.sampled_from(["put", "take", "close"]), max_size=30))
def test_every_item_is_taken_replaced_or_refused_exactly_once(actions: list[str]) -> None:
    box: Mailbox[int] = Mailbox()
    taken: list[int] = []
    returned: list[int] = []
    count, full, closed = 0, False, False
    for action in actions:
        if action == "put":
            back = box.put(count)
            assert back == (count if closed else count - 1 if full else None)
            returned += [] if back is None else [back]
            full = full or not closed
            count += 1
        elif action == "take" and (full or closed):  # else it would wait
            item = box.take()
            assert (item is not None) is full
            taken += [] if item is None else [item]
            full = False
        elif action == "close":
            box.close()
            closed = True
    box.close()
    while (item := box.take()) is not None:
        taken.append(item)
    assert sorted(taken + returned) == list(range(count))
    assert taken == sorted(taken)


class Published(FrameObserver):
    def __init__(self, ledger: FrameLedger) -> None:
        self._ledger = ledger

    def need(self) -> Need:
        return Need.DEPTH

    def see(self, seen: FrameResult) -> None:
        self._ledger.settle(seen.frame.seq, "published")


def pipeline(
    source: Any,
    calibration: Calibration,
    states: list[SourceState],
    make: type[FrameObserver] = Published,
) -> Pipeline:
    running, ledger = (
        SimpleNamespace(reconstructor=make_reconstructor(calibration, PROFILES["fast"])),
        FrameLedger(),
    )
    return Pipeline(
        source, lambda: running.reconstructor, [make(ledger)], ledger, Timings(), states.append
    )  # type: ignore[call-arg]


def test_a_stop_finishes_the_frame_that_waits(
    calibration: Calibration, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    states: list[SourceState] = []
    line = pipeline(scripted([pictures.free] * 50 + [None]), calibration, states)
    line.start()
    wait_until(lambda: states[-1:] == [SourceState("ended")])
    assert line.stop(10)
    counts = line.ledger.counts()
    assert counts.pending == 0
    assert counts.captured == counts.published + counts.superseded == 50
    assert counts.published >= 1


def test_an_exception_in_any_thread_is_reported_with_the_threads_name(
    calibration: Calibration, scripted: Any, wait_until: Any
) -> None:
    crashes: list[Crash] = []
    before = threading.excepthook
    with crashes_to(crashes.append):
        line = pipeline(scripted(ConfigError("x: found nothing")), calibration, [])
        line.start()
        wait_until(lambda: crashes != [])
        line.stop(10)
    assert [(c.thread, str(c.error)) for c in crashes] == [("grab", "x: found nothing")]
    assert threading.excepthook is before


GONE = DeviceError("camera /dev/video9: gone")


class Rig:
    """A grab worker on a scripted source, and what it reported."""

    def __init__(self, source: Any) -> None:
        self.mailbox: Mailbox[Frame] = Mailbox()
        self.ledger = FrameLedger()
        self.reported: list[SourceState] = []
        self.source = source
        self.grab = Grab(source, self.mailbox, self.ledger, self.reported.append)
        self.thread = threading.Thread(target=self.grab.run)

    def states(self) -> list[tuple[str, str]]:
        return [(state.state, str(state.reason or "")) for state in self.reported]


@pytest.fixture
def rig() -> Iterator[Callable[[Any], Rig]]:
    made: list[Rig] = []

    def start(source: Any) -> Rig:
        made.append(Rig(source))
        made[-1].thread.start()
        return made[-1]

    yield start
    for r in made:
        r.grab.stop()
        r.thread.join(patience(10))
        assert not r.thread.is_alive()
        assert not r.source.is_open


def test_a_finite_source_is_read_to_its_end(rig: Any, scripted: Any, pictures: Any) -> None:
    r = rig(
        scripted([pictures.free, pictures.free, DecodeError("torn.png: cut"), pictures.free, None])
    )
    r.thread.join(patience(10))
    assert r.states() == [("streaming", ""), ("ended", "")]
    assert r.reported[0].details == {"script": "test"}
    counts = r.ledger.counts()
    assert (counts.captured, counts.failed, counts.superseded, counts.pending) == (4, 1, 2, 1)
    newest = r.mailbox.take()
    assert newest is not None
    assert newest.seq == 2


def test_a_source_that_begins_with_what_is_no_image_says_so_once(
    rig: Any, scripted: Any, pictures: Any
) -> None:
    r = rig(
        scripted(
            [
                DecodeError("0.png: cut"),
                DecodeError("1.png: cut"),
                pictures.free,
                DecodeError("3.png"),
                None,
            ]
        )
    )
    r.thread.join(patience(10))
    assert r.states() == [("away", "0.png: cut"), ("streaming", ""), ("ended", "")]
    assert r.reported[0].reason == Reason(ReasonCode.DECODE, "0.png: cut")
    assert r.ledger.counts().failed == 3


@pytest.mark.slow
def test_pauses_grow_to_a_second_and_only_a_frame_resets_them(
    rig: Any, scripted: Any, pictures: Any, wait_until: Any
) -> None:
    silent: list[Any] = [[GONE]] * 4  # opens, but gives no frame
    r = rig(scripted(*silent, [pictures.free, GONE], [None]))
    wait_until(lambda: r.states()[-1:] == [("ended", "")])
    pauses = [
        (b - a) / 1e9 for a, b in zip(r.source.opened_ns, r.source.opened_ns[1:], strict=False)
    ]
    for pause, least in zip(pauses, [0.1, 0.2, 0.4, 0.8, 0.1], strict=True):
        assert pause >= 0.99 * least
    assert r.grab.retry_s == 0.2  # the reset and one more pause


def test_stop_ends_a_long_pause(rig: Any, scripted: Any, wait_until: Any) -> None:
    r = rig(scripted(*[GONE] * 100))
    wait_until(lambda: len(r.source.opened_ns) >= 3)
    r.grab.stop()
    r.thread.join(patience(10))
    assert not r.thread.is_alive()
    assert r.states() == [("away", str(GONE))]


class Collected(FrameObserver):
    """Keeps everything and settles by kind."""

    def __init__(self, ledger: FrameLedger, *, asks: bool = True) -> None:
        self.ledger = ledger
        self.asks = asks
        self.results: list[Reconstruction] = []

    def need(self) -> Need:
        return Need.DEPTH if self.asks else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        self.ledger.settle(seen.frame.seq, self._outcome(seen))

    def _outcome(self, seen: FrameResult) -> FrameOutcome:
        if (result := seen.reconstruction) is None:
            return "unasked"
        assert seen.frame.seq == result.seq
        assert seen.calibration
        assert seen.calibration.crc32
        assert seen.step_ms > 0
        self.results.append(result)
        if not result.valid:
            return "invalid"
        return "published" if result.contact else "without_contact"


class Watched(FrameObserver):
    """Asks for depth while it watches; `once`: for one frame."""

    def __init__(self, *, on: bool) -> None:
        self.on = on
        self.once = False
        self.seqs: list[int] = []

    def need(self) -> Need:
        return Need.DEPTH if self.on else Need.CONTACT

    def see(self, seen: FrameResult) -> None:
        if self.on and seen.reconstruction:
            self.seqs.append(seen.reconstruction.seq)
            self.on &= not self.once


def test_reconstruct_delivers_times_and_settles_every_frame(
    calibration: Calibration, pictures: Any, wait_until: Any
) -> None:
    mailbox: Mailbox[Frame] = Mailbox()
    ledger, timings, watched = FrameLedger(), Timings(), Watched(on=True)
    running, sink = (
        SimpleNamespace(reconstructor=make_reconstructor(calibration, PROFILES["fast"])),
        Collected(ledger),
    )
    worker = Reconstruct(lambda: running.reconstructor, mailbox, timings, [sink, watched])
    thread = threading.Thread(target=worker.run)
    thread.start()
    for seq, image in enumerate([pictures.free, pictures.touched, pictures.black]):
        ledger.captured(seq)
        assert mailbox.put(Frame(seq, 0, 0, image)) is None
        wait_until(lambda seq=seq: len(watched.seqs) == seq + 1)
    running.reconstructor = Reconstructor(calibration, PROFILES["paper"])
    ledger.captured(3)
    mailbox.put(Frame(3, 0, 0, pictures.free))
    mailbox.close()
    thread.join(patience(10))
    assert not thread.is_alive()
    assert [(r.valid, r.contact, r.profile) for r in sink.results] == [
        (True, False, "fast"),
        (True, True, "fast"),
        (False, False, "fast"),
        (True, False, "paper"),
    ]
    counts = ledger.counts().as_dict()
    assert (
        counts["captured"],
        counts["published"],
        counts["without_contact"],
        counts["invalid"],
    ) == (4, 1, 2, 1)
    assert counts["pending"] == 0
    stages = timings.percentiles()
    assert set(stages) == {"wait", "check", "grey", "gate", "depth", "cloud", "deliver", "latency"}
    assert all(0 < p["p50"] <= p["p99"] for p in stages.values())


class InTurn:
    """A mailbox that has each frame reconstructed at once, in the thread that puts it."""

    def __init__(self) -> None:
        self.worker: Any = None
        self._item: Frame | None = None

    def put(self, item: Frame) -> None:
        self._item = item
        self.worker.run()

    def take(self) -> Frame | None:
        item, self._item = self._item, None
        return item


class Alone:
    """`Grab` and `Reconstruct` on a scripted source, in one thread."""

    def __init__(
        self, source: Any, calibration: Calibration, tapped: FrameObserver, watched: Watched
    ) -> None:
        self.ledger, self.timings = FrameLedger(), Timings()
        self.sink = Collected(self.ledger, asks=False)
        running = SimpleNamespace(reconstructor=make_reconstructor(calibration, PROFILES["fast"]))
        mailbox: Any = InTurn()
        mailbox.worker = self.worker = Reconstruct(
            lambda: running.reconstructor, mailbox, self.timings, [self.sink, watched]
        )
        self.states: list[SourceState] = []
        Grab(
            source, mailbox, self.ledger, self.states.append, [tapped], self.worker.wants_next
        ).run()


def test_of_frames_that_nobody_asks_for_one_in_six_is_looked_at_up_to_the_gate(
    calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    watched = Watched(on=False)
    free, touched, black = pictures.free, pictures.touched, pictures.black
    others = [touched] * (LOOK_EVERY - 1)
    # After an invalid frame all are looked at; after one that somebody asked for it is one
    # in six again.
    watched.once = True
    script = [
        free,
        *others,
        touched,
        *others,
        black,
        black,
        lambda: setattr(watched, "on", True),
        touched,
    ]
    script += [free, *others[1:], None]
    source = scripted(script)
    alone = Alone(source, calibration, FrameObserver(), watched)
    found = [(r.seq, r.valid, r.contact) for r in alone.sink.results]
    last = 2 * LOOK_EVERY + 2
    assert found == [
        (0, True, False),
        (last - 2, False, False),
        (last - 1, False, False),
        (last, True, True),
    ]
    assert source.skipped == 3 * (LOOK_EVERY - 1)
    assert alone.ledger.counts().as_dict() == {
        **dict.fromkeys(("superseded", "failed", "pending"), 0),
        **dict.fromkeys(("without_contact", "published"), 1),
        "invalid": 2,
        "unasked": 1 + source.skipped,
        "captured": 5 + source.skipped,
    }
    assert alone.worker.processed == 5
    assert alone.timings.percentiles()["check"]  # of those that were looked at
    assert watched.seqs == [last]
    assert [state.state for state in alone.states] == ["streaming", "ended"]


class Taping(FrameObserver):
    """Takes every frame while it is on."""

    def __init__(self) -> None:
        self.on = True
        self.seqs: list[int] = []

    @property
    def tap(self) -> Callable[[Frame], None] | None:
        return (lambda frame: self.seqs.append(frame.seq)) if self.on else None


def test_what_is_recorded_is_read_and_looked_at_no_more_often(
    calibration: Calibration, pictures: Any, scripted: Any
) -> None:
    tape = Taping()
    source = scripted(
        [*[pictures.free] * (LOOK_EVERY + 1), lambda: setattr(tape, "on", False), None]
    )
    alone = Alone(source, calibration, tape, Watched(on=False))
    assert tape.seqs == list(range(LOOK_EVERY + 1))
    assert source.skipped == 0
    counts = alone.ledger.counts()
    assert (alone.worker.processed, counts.without_contact, counts.unasked) == (
        2,
        2,
        LOOK_EVERY - 1,
    )
