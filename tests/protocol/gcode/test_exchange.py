from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.protocol.gcode.answers import Position
from tacshade_edge.protocol.gcode.exchange import LINE_BYTES_MAX, Exchange


def begun(command: str = "M114") -> Exchange:
    exchange = Exchange()
    assert exchange.begin_anew() == b"N0 M110 N0*125\n"
    exchange.receive(b"ok\n")
    exchange.begin(command)
    return exchange


@given(st.data())
def test_an_answer_however_its_bytes_are_cut(data: st.DataObject) -> None:
    answer = b" T:21.4 /0.0\r\necho:busy: processing\nX:1.00 Y:2.00 Z:3.00 E:0.00 Count X:1\r\nok\r\n"
    exchange = begun()
    while answer:
        assert not exchange.is_done
        size = data.draw(st.integers(1, len(answer)))
        assert exchange.receive(answer[:size]) == b""
        answer = answer[size:]
    assert exchange.is_done
    assert exchange.position == Position(1, 2, 3)
    assert exchange.said == ("T:21.4 /0.0",)
    assert exchange.busy == 1
    assert not exchange.failure


def test_a_damaged_line_is_sent_again_once_it_was_asked_for() -> None:
    exchange = begun("G1 X1.000 Y2.000 Z3.000 F600")
    assert exchange.receive(b"Error:checksum mismatch, Last Line: 0\nResend: 1\n") == b""
    assert exchange.receive(b"ok\n") == b"N1 G1 X1.000 Y2.000 Z3.000 F600*44\n"
    assert not exchange.is_done
    assert exchange.receive(b"ok\n") == b""
    assert exchange.is_done


@pytest.mark.parametrize(
    ("said", "why"),
    [
        (b"start\n", "restarted"),
        (b"!! Timer too close\n", "Timer too close"),
        (b"Resend: 2\n", "asked for line 2 again, but the last one was 1"),
        (b"ok\nok\n", "answered although no command was open"),
        (4 * b"Resend: 1\n", "4 times"),
        (b"x" * (LINE_BYTES_MAX + 1), "without an end of line"),
    ],
)
def test_what_ends_belief(said: bytes, why: str) -> None:
    exchange = begun()
    exchange.receive(said)
    assert why in exchange.failure
    with pytest.raises(RuntimeError):
        exchange.begin("G1")
    exchange.receive(b"Error: another\n")
    assert why in exchange.failure  # the first stays
    exchange.begin_anew()
    assert not exchange.failure
    assert exchange.has_restarted == (said == b"start\n")


def test_one_command_at_a_time() -> None:
    with pytest.raises(RuntimeError, match="the printer has not answered the command before it"):
        begun().begin("M400")


@given(st.lists(st.binary(max_size=600), max_size=10))
def test_no_bytes_raise_or_grow(chunks: list[bytes]) -> None:
    exchange = begun()
    for chunk in chunks:
        exchange.receive(chunk)
        assert len(exchange._buffer) <= LINE_BYTES_MAX
        assert len(exchange.said) <= 32
