from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.protocol.gcode.answers import (
    Answer,
    Busy,
    Failed,
    Ok,
    Position,
    Resend,
    Restarted,
    Said,
    parse,
)


@pytest.mark.parametrize(
    ("line", "answers"),
    [
        (b"ok", (Ok(),)),
        (b"ok\r", (Ok(),)),
        (b"ok N12 P15 B3", (Ok(),)),
        (b"ok T:21.4 /0.0 B:20.9 /0.0 @:0 B@:0", (Ok(),)),
        (b"ok C: X:10.000 Y:-5.000 Z:3.250 E:0.000", (Position(10, -5, 3.25), Ok())),
        (b"X:10.00 Y:-5.00 Z:3.25 E:0.00 Count X:800 Y:-400 Z:1300", (Position(10, -5, 3.25),)),
        (b"X:10.000 Y:0.000 Z:3.250 E:0.000", (Position(10, 0, 3.25),)),
        (b"echo:busy: processing", (Busy(),)),
        (b"busy: paused for user", (Busy(),)),
        (b"Resend: 41", (Resend(41),)),
        (b"rs N41", (Resend(41),)),
        (b"Error:checksum mismatch, Last Line: 40", (Said("Error:checksum mismatch, Last Line: 40"),)),
        (b"Error:Printer halted. kill() called!", (Failed("Error:Printer halted. kill() called!"),)),
        (b"error:8", (Failed("error:8"),)),
        (b"!! Must home axis first: 1.0 2.0 3.0", (Failed("!! Must home axis first: 1.0 2.0 3.0"),)),
        (b"// Klipper state: Shutdown", (Failed("// Klipper state: Shutdown"),)),
        (b"// Klipper state: Ready", (Restarted(),)),
        (b'echo:Unknown command: "M400"', (Failed('echo:Unknown command: "M400"'),)),
        (b"echo:Home X Y Z First", (Failed("echo:Home X Y Z First"),)),
        (b"echo:Home XYZ First", (Failed("echo:Home XYZ First"),)),
        (b"start", (Restarted(),)),
        (b"\x00\xfestart", (Restarted(),)),
        (b" T:21.4 /0.0 B:20.9 /0.0 @:0 B@:0", (Said("T:21.4 /0.0 B:20.9 /0.0 @:0 B@:0"),)),
        (b"okay", (Said("okay"),)),
        (b"X:nan Y:0.00 Z:0.00", (Said("X:nan Y:0.00 Z:0.00"),)),
        (b"restart", (Said("restart"),)),
        (b"", ()),
    ],
)
def test_lines_of_real_printers(line: bytes, answers: tuple[Answer, ...]) -> None:
    assert parse(line) == answers


@given(st.binary(max_size=200))
def test_nothing_raises(line: bytes) -> None:
    assert len(parse(line)) <= 2


@given(st.floats(-9999, 9999), st.floats(-9999, 9999), st.floats(-9999, 9999), st.integers(1, 6))
def test_a_position_comes_back(x: float, y: float, z: float, digits: int) -> None:
    texts = [f"{v:.{digits}f}" for v in (x, y, z)]
    line = "X:{} Y:{} Z:{} E:0.00".format(*texts)
    assert parse(line.encode()) == (Position(*map(float, texts)),)
