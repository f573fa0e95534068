"""Commands as the world has them, the answers of real firmwares, and one exchange at a time."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.protocol import gcode
from tacshade_edge.protocol.gcode import (
    LINE_BYTES_MAX,
    Answer,
    Busy,
    Exchange,
    Failed,
    Ok,
    Position,
    Resend,
    Restarted,
    Said,
    parse,
)

OFF = "M84 S0"


@pytest.mark.parametrize(
    ("number", "command", "line"),
    [  # of the RepRap wiki's page "G-code"
        (3, "T0", b"N3 T0*57\n"),
        (4, "G92 E0", b"N4 G92 E0*67\n"),
        (5, "G28", b"N5 G28*22\n"),
        (6, "G1 F1500.0", b"N6 G1 F1500.0*82\n"),
        (7, "G1 X2.0 Y2.0 F3000.0", b"N7 G1 X2.0 Y2.0 F3000.0*85\n"),
    ],
)
def test_lines_as_the_world_has_them(number: int, command: str, line: bytes) -> None:
    assert gcode.numbered(number, command) == line


@given(st.integers(0, 2**31 - 1), st.floats(-2000, 2000), st.integers(0, 30), st.integers(0, 7))
def test_a_turned_bit_shows(number: int, x_mm: float, place: int, bit: int) -> None:
    line = bytearray(gcode.numbered(number, gcode.straight(x_mm, 0, 0, 10)))
    body, _, checksum = bytes(line[:-1]).rpartition(b"*")
    damaged = bytearray(body)
    damaged[place % len(body)] ^= 1 << bit
    found = 0
    for byte in damaged:
        found ^= byte
    assert found != int(checksum)


@given(st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(-2000, 2000), st.floats(0.02, 100))
def test_a_move_says_its_place_within_half_a_micrometre_and_is_never_faster(
    x_mm: float, y_mm: float, z_mm: float, feed_mm_s: float
) -> None:
    command = gcode.straight(x_mm, y_mm, z_mm, feed_mm_s)
    found = re.fullmatch(r"G1 X(-?\d+\.\d{3}) Y(-?\d+\.\d{3}) Z(-?\d+\.\d{3}) F(\d+)", command)
    assert found is not None
    assert "-0.000" not in command
    for text, value in zip(found.groups()[:3], (x_mm, y_mm, z_mm), strict=True):
        assert abs(float(text) - value) <= 0.000501
    assert int(found[4]) <= 60 * feed_mm_s


@pytest.mark.parametrize(("z_mm", "feed_mm_s"), [(float("nan"), 10), (float("inf"), 10), (1e7, 10), (0, 0.01), (0, -5)])
def test_what_is_no_move_is_not_sent(z_mm: float, feed_mm_s: float) -> None:
    with pytest.raises(ValueError, match="is n"):
        gcode.straight(0, 0, z_mm, feed_mm_s)


@pytest.mark.parametrize(
    ("about", "name", "command"),
    [  # what they answer to M115
        ("FIRMWARE_NAME:Marlin 2.1.2 (Jan 1 2024) SOURCE_CODE_URL:github.com/Marlin", "Marlin 2.1.2 (Jan 1 2024)", OFF),
        ("FIRMWARE_NAME:Marlin V1; Sprinter/grbl mashup for gen6 FIRMWARE_URL:http://x", None, OFF),
        ("FIRMWARE_NAME:Prusa-Firmware 3.13.3 based on Marlin FIRMWARE_URL:https://x PROTOCOL_VERSION:1.0", None, OFF),
        ("FIRMWARE_NAME:Prusa-Firmware-Buddy 5.1.2 (Github) SOURCE_CODE_URL:https://x", None, OFF),
        ("FIRMWARE_NAME:Klipper FIRMWARE_VERSION:v0.12.0-1-g0", "Klipper", "SET_IDLE_TIMEOUT TIMEOUT=86400"),
        ("// FIRMWARE_NAME:Kalico FIRMWARE_VERSION:v2024", "Kalico", "SET_IDLE_TIMEOUT TIMEOUT=86400"),
        ("FIRMWARE_NAME: RepRapFirmware for Duet 2 WiFi/Ethernet FIRMWARE_VERSION: 3.5.1 ELECTRONICS: Duet", None, ""),
        ("FIRMWARE_NAME:Smoothieware, FIRMWARE_URL:http%3A//smoothieware.org, X-AXES:3", "Smoothieware", ""),
        ("FIRMWARE_NAME:Repetier_1.0.4 COMPILED:Jan 1 2021 FIRMWARE_URL:https://x", "Repetier_1.0.4", None),
        ("FIRMWARE_NAME:Not Marlin", "Not Marlin", None),
        ("NAME. Malyan VER: 4.0 MODEL: M200 HW: HH02", "", None),
    ],
)
def test_only_a_known_firmware_is_told_to_keep_its_motors_on(about: str, name: str | None, command: str | None) -> None:
    found = gcode.firmware_name(about)
    assert name is None or found == name
    assert gcode.stay_awake(found) == command


@pytest.mark.parametrize(
    ("line", "answers"),
    [
        (b"ok", (Ok(),)),
        (b"ok\r", (Ok(),)),
        (b"ok N12 P15 B3", (Said("N12 P15 B3"), Ok())),
        (b"ok T:21.4 /0.0 B:20.9 /0.0 @:0 B@:0", (Said("T:21.4 /0.0 B:20.9 /0.0 @:0 B@:0"), Ok())),
        (b"ok FIRMWARE_NAME:Klipper FIRMWARE_VERSION:v1", (Said("FIRMWARE_NAME:Klipper FIRMWARE_VERSION:v1"), Ok())),
        (b"ok error: no", (Failed("error: no"), Ok())),
        (b"ok C: X:10.0000 Y:-5.0000 Z:3.2500 E:0.0000", (Position(10, -5, 3.25, 1e-4), Ok())),  # Smoothieware
        (b"X:10.00 Y:-5.00 Z:3.25 E:0.00 Count X:800 Y:-400 Z:1300", (Position(10, -5, 3.25, 0.01),)),  # Marlin
        (b"X:10.00 Y:-5.00 Z:3.25 Count X: 800 Y:-400 Z:1300", (Position(10, -5, 3.25, 0.01),)),  # no extruder
        (b"X:10.00 Y:-5.00 Z:3.25 E:0.00 Count A:800 B:-400 Z:1300", (Position(10, -5, 3.25, 0.01),)),  # Prusa CoreXY
        (b"X:10.00 Y:-5.00 Z:3.25 E:0.00 Count X: 10.01 Y:-5.01 Z:3.26", (Position(10, -5, 3.25, 0.01),)),  # Prusa
        (b"X:10.00 Y:-5.00 Z:3.25 Extruder:0.00 Count X:800 Y:0 Z:0", (Position(10, -5, 3.25, 0.01),)),  # ADVi3++
        (b"C: X:10.000 Y:-5.000 Z:3.250 E:51.0 E0:51.0 Count 800 16 20", (Position(10, -5, 3.25, 1e-3),)),  # Duet
        (b"X:10.000 Y:-5.000 U:1.000 Z:3.250 Machine 1.0 2.0 3.0", (Position(10, -5, 3.25, 1e-3),)),  # Duet, 4 axes
        (b"X:10.000 Y:0.000 Z:3.250 E:0.000", (Position(10, 0, 3.25, 1e-3),)),  # Klipper
        (b"X: 10.000, Y: 0.000, Z: 3.250", (Position(10, 0, 3.25, 1e-3),)),
        (b"X:10.0 Y:-5.0 Z:3.2 E:0.0", (Position(10, -5, 3.2, 0.1),)),
        (b"X:10 Y:-5 Z:3.25", (Position(10, -5, 3.25, 0.01),)),
        (b"X:10 Y:-5 Z:3 E:0", (Said("X:10 Y:-5 Z:3 E:0"),)),  # too coarse
        (b"X:1.00 Y:2.00 Count X:80 Y:160 Z:3.00", (Said("X:1.00 Y:2.00 Count X:80 Y:160 Z:3.00"),)),
        (b"X:1.00 Y:2.00 Z:1e5", (Said("X:1.00 Y:2.00 Z:1e5"),)),
        (b"<Idle|MPos:0.000,0.000,0.000|FS:0,0>", (Said("<Idle|MPos:0.000,0.000,0.000|FS:0,0>"),)),  # GRBL
        (b"echo:  M92 X80.00 Y80.00 Z400.00", (Said("echo:  M92 X80.00 Y80.00 Z400.00"),)),
        (b"Error: G0/G1: insufficient axes homed", (Failed("Error: G0/G1: insufficient axes homed"),)),  # Duet
        (b"ALARM: Hard limit +X", (Failed("ALARM: Hard limit +X"),)),  # Smoothieware
        (b"echo:busy: processing", (Busy(),)),
        (b"busy: paused for user", (Busy(),)),
        (b"Resend: 41", (Resend(41),)),
        (b"rs N41", (Resend(41),)),
        (b"Resend: -1", (Failed("Resend: -1"),)),
        (b"Resend: 4294967295", (Failed("Resend: 4294967295"),)),
        (b"X:1,50 Y:2,50 Z:3.50", (Said("X:1,50 Y:2,50 Z:3.50"),)),
        (b"Grbl 1.1h ['$' for help]", (Restarted(),)),
        (b"Smoothie", (Restarted(),)),
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
    assert parse(line.encode()) == (Position(*map(float, texts), 10.0**-digits),)


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
    assert exchange.position == Position(1, 2, 3, 0.01)
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
        (b"Error:checksum mismatch, Last Line: 0\nRe\x80end: 1\nok\n", "did not ask for it again"),
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
