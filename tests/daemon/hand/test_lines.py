from __future__ import annotations

from collections.abc import Iterator

import pytest

from tacshade_edge.daemon.hand import Lines
from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.topics import Finger


@pytest.fixture
def lines() -> Iterator[Lines]:
    made = Lines(["thumb", "index"])
    yield made
    made.close()


def test_what_a_finger_tells_comes_from_that_finger_in_order(lines: Lines) -> None:
    for seq in range(3):
        lines.fingers["index"].report(Finger(state="free", seq=seq))
    assert lines.hand["thumb"].take() is None
    told = [lines.hand["index"].take() for _ in range(4)]
    assert [finger and finger.seq for finger in told] == [0, 1, 2, None]


def test_a_hand_that_reads_nothing_keeps_no_finger_waiting_and_harms_no_other(lines: Lines) -> None:
    for seq in range(2000):
        lines.fingers["thumb"].report(Finger(state="free", seq=seq))
    lines.fingers["index"].report(Finger(state="contact"))
    assert lines.hand["index"].take() == Finger(state="contact")
    taken = 0
    while lines.hand["thumb"].take():
        taken += 1
    assert 1 <= taken < 2000


def test_what_is_wanted_is_seen_by_all(lines: Lines) -> None:
    assert [line.wanted for line in lines.fingers.values()] == [False, False]
    lines.want(True)
    assert [line.wanted for line in lines.fingers.values()] == [True, True]
    lines.want(False)
    assert not lines.fingers["thumb"].wanted


def test_a_process_that_ended_is_told_for(lines: Lines) -> None:
    lines.end("thumb")
    lines.end("hand/left")  # the hand's own is none of them
    assert lines.hand["thumb"].take() == Finger(state="away", reason_code="daemon_stopped")


def test_bytes_that_are_no_finger_are_refused(lines: Lines) -> None:
    sock = lines.fingers["thumb"]._sock
    for sent in (b"x", b"{}", b'{"state": "contact", "reason_code": "' + bytes(40_000)):
        sock.send(sent)
        with pytest.raises(DecodeError, match=r"^a finger: "):
            lines.hand["thumb"].take()
