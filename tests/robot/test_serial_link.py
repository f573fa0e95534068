"""The channel without a port: a robot that sends anything, and what is done of it."""

from __future__ import annotations

import json
import random
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.robot.framing import cobs_decode, cobs_encode
from tacshade_edge.robot.line import parse_line, seal
from tacshade_edge.robot.pose import PoseSample, encode_pose
from tacshade_edge.robot.serial_link import REPLIES_KEPT, Greeted, PoseArrived, Received, SerialLink
from tacshade_edge.robot.verbs import USAGE, Command
from tacshade_edge.wire.results import SessionBegun

VECTORS = json.loads((Path(__file__).parents[1] / "wire" / "vectors" / "serial.json").read_text())
IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@dataclass
class Desk:
    """A link whose commands are done at once, and a book of what was done."""

    link: SerialLink = field(default_factory=SerialLink)
    done: list[Command] = field(default_factory=list)
    poses: list[PoseArrived] = field(default_factory=list)
    greeted: list[str] = field(default_factory=list)

    def send(self, data: bytes, now_ns: int = 0, *, answer: bool = True) -> list[str]:
        """What is said to that, without the checksums, which must be right."""
        for event in self.link.receive(data, now_ns):
            self.take(event, answer)
        return texts(self.link.take_output())

    def take(self, event: Received, answer: bool) -> None:
        if isinstance(event, PoseArrived):
            self.poses.append(event)
        elif isinstance(event, Greeted):
            self.greeted.append(event.boot)
        else:
            self.done.append(event)
            if answer:
                self.link.answer(event, SessionBegun(f"done-{len(self.done)}"))

    def verbs(self) -> list[tuple[int | None, str]]:
        return [(command.seq, command.verb) for command in self.done]


def texts(output: bytes) -> list[str]:
    """Replies as text: lines, then frames where the mode changed."""
    lines, newline, frames = output.rpartition(b"\n")
    raws = lines.split(b"\n") if newline else []
    raws += [cobs_decode(frame)[1:] for frame in frames.split(b"\0") if frame]
    assert not any(isinstance(parse_line(raw), Reason) or len(raw) > 255 for raw in raws)
    return [raw.decode().rpartition("*")[0] for raw in raws]


def frame(raw: bytes) -> bytes:
    return cobs_encode(raw) + b"\0"


def pose(seq: int, t_ns: int = 0) -> bytes:
    return encode_pose(PoseSample(seq, t_ns, IDENTITY))


def line_frame(text: str) -> bytes:
    return frame(b"L" + seal(text)[:-1])


def test_a_person_types() -> None:
    desk = Desk()
    assert desk.send(b"help\r\n") == [f"OK - {' '.join(USAGE)}; HELP VERB says more"]
    assert desk.send(b"HELP pose\r") == ["OK - POSE t x y z qw qx qy qz"]
    assert desk.send(b"status\n") == ["OK - name=done-1"]
    assert desk.send(b"status\n") == ["OK - name=done-2"]  # without a number nothing is a repeat
    assert desk.send(b"stitch begin pad\n") == ["OK - name=done-3"]
    assert desk.done[-1].args == ("BEGIN", "pad")
    assert desk.send(b"\n\r\n\n") == []


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("FOO", "ERR - VERB found FOO, expected one of HELLO SYNC POSE"),
        ("#9 FOO", "ERR 9 VERB found FOO"),
        ("#9 CAPTURE now", "ERR 9 ARGS expected CAPTURE"),
        ("#9 STITCH START", "ERR 9 ARGS expected STITCH BEGIN"),
        ("#9 SYNC 1.5", "ERR 9 ARGS found '1.5', expected a whole number of nanoseconds"),
        ("#9 HELLO 2", "ERR 9 VERSION found 2, expected 1"),
        ("#9 HELLO 1 crc=no", "ERR 9 ARGS found crc=no, expected HELLO 1 [crc=req|opt] [boot=ID]"),
        ("#99999 STATUS", "ERR - SYNTAX found #99999"),
        ("#9 STATUS*0000", "ERR - CRC found 0000, expected "),
        ("POSE 1 2 3", "ERR - ARGS POSE: found 3 values"),
    ],
)
def test_a_mistake_is_reported_and_takes_no_number(line: str, answer: str) -> None:
    desk = Desk()
    (said,) = desk.send(line.encode() + b"\n")
    assert said.startswith(answer)
    assert desk.done == []
    assert desk.send(b"#9 STATUS\n") == ["OK 9 name=done-1"]


def test_a_session_of_the_vectors() -> None:
    link = SerialLink()
    for step in VECTORS["session"]:
        link.receive(step["in"].encode() + b"\n", 0)
        said = link.take_output()
        assert said == (step["out"].encode() + b"\n" if step["out"] else b"")
    (vector,) = VECTORS["poses"]
    (event,) = link.receive(bytes.fromhex(vector["frame"]), 5)
    assert isinstance(event, PoseArrived)
    assert (event.sample.seq, event.sample.t_ns, event.arrived_ns) == (
        vector["seq"],
        vector["t_ns"],
        5,
    )
    (line,) = VECTORS["line_frames"]
    (command,) = link.receive(bytes.fromhex(line["frame"]), 6)
    assert isinstance(command, Command)
    assert (command.seq, command.verb, command.arrived_ns) == (4, "STATUS", 6)


def test_a_repeated_line_gets_its_reply_again_and_is_not_done_again() -> None:
    desk = Desk()
    for line in (b"#7 CAPTURE\n", b"#7 CAPTURE\n", seal("#7 CAPTURE")):
        assert desk.send(line) == ["OK 7 name=done-1"]
    assert desk.verbs() == [(7, "CAPTURE")]
    assert desk.send(b"#7 REFERENCE\n") == [
        "ERR 7 REUSED found the number of another line, expected a new number"
    ]
    assert desk.link.counts.repeats == 2


def test_a_line_that_is_still_being_done_is_answered_once_it_is() -> None:
    desk = Desk()
    assert desk.send(b"#7 CAPTURE\n", answer=False) == []
    assert desk.send(b"#7 CAPTURE\n") == []
    desk.link.answer(desk.done[0], Reason(ReasonCode.TIMEOUT, "no frame"))
    assert texts(desk.link.take_output()) == ["ERR 7 TIMEOUT no frame"]
    assert desk.send(b"#7 CAPTURE\n") == ["ERR 7 TIMEOUT no frame"]
    assert desk.verbs() == [(7, "CAPTURE")]


def test_numbers_that_are_too_old_to_be_known_are_refused() -> None:
    desk = Desk()
    for seq in range(100, 100 + 2 * REPLIES_KEPT):
        desk.send(b"#%d STATUS\n" % seq)
    newest = 100 + 2 * REPLIES_KEPT - 1
    assert desk.send(b"#%d STATUS\n" % (newest - REPLIES_KEPT + 1)) == [
        f"OK {newest - REPLIES_KEPT + 1} name=done-65"
    ]
    assert desk.send(b"#%d STATUS\n" % (newest - REPLIES_KEPT)) == [
        (
            f"ERR {newest - REPLIES_KEPT} STALE found an old line number, expected HELLO or a "
            f"number above #{newest}"
        )
    ]
    assert len(desk.done) == 2 * REPLIES_KEPT


def test_hello_begins_anew_unless_it_is_the_same_robot_that_repeats_itself() -> None:
    desk = Desk()
    desk.send(b"#1 HELLO 1 boot=a\n#2 CAPTURE\n")
    assert desk.send(b"#1 HELLO 1 boot=a\n#2 CAPTURE\n") == [
        "OK 1 tacshade 1 crc=opt mode=ASCII",
        "OK 2 name=done-1",
    ]
    assert desk.send(b"#1 HELLO 1 boot=b\n#2 CAPTURE\n") == [
        "OK 1 tacshade 1 crc=opt mode=ASCII",
        "OK 2 name=done-2",
    ]
    assert desk.send(b"HELLO 1\n#2 CAPTURE\n")[-1] == "OK 2 name=done-3"
    assert desk.send(b"HELLO 1\n#2 CAPTURE\n")[-1] == "OK 2 name=done-4"
    assert desk.greeted == ["a", "b", "", ""]


def test_the_answer_to_a_session_that_is_over_is_not_given() -> None:
    desk = Desk()
    desk.send(b"#7 CAPTURE\n", answer=False)
    desk.send(b"HELLO 1\n#7 STATUS\n", answer=False)
    desk.link.answer(desk.done[0], SessionBegun("late"))
    assert desk.link.take_output() == b""
    desk.link.answer(desk.done[1], SessionBegun("mine"))
    assert texts(desk.link.take_output()) == ["OK 7 name=mine"]


def test_checksums_once_required() -> None:
    desk = Desk()
    desk.send(seal("#1 HELLO 1 crc=req"))
    assert desk.send(b"#2 CAPTURE\n") == [
        "ERR - CRC found no checksum, expected one, because HELLO asked for checksums"
    ]
    assert desk.send(b"POSE 1 0 0 0 1 0 0 0\n")[0].startswith("ERR - CRC")
    assert (desk.done, desk.poses) == ([], [])
    assert desk.send(seal("#2 CAPTURE")) == ["OK 2 name=done-1"]


def test_our_own_lines_and_garbage_are_not_answered() -> None:
    desk = Desk()
    echoed = seal("OK 1 done") + b"ERR - VERB found FOO\nEVT READY tacshade 1\nOK 3 cu*1234\n"
    assert desk.send(echoed) == []
    assert desk.send(b"\xff\xfe\x07\n" + b"x" * 1000 + b"\n" + b"\x80" * 255 + b"\n") == []
    counts = desk.link.counts
    assert (counts.echoes, counts.garbage, counts.garbage_bytes) == (3, 3, 3 + 1000 + 255)
    assert desk.send(b"#1 STATUS\n") == ["OK 1 name=done-1"]


def test_binary_mode_and_back() -> None:
    desk = Desk()
    assert desk.send(
        seal("#1 MODE BIN") + frame(pose(0)) + line_frame("#2 CAPTURE") + frame(pose(2))
    ) == [
        "OK 1 BIN",
        "OK 2 name=done-1",
    ]
    assert [(p.sample.seq, p.missing) for p in desk.poses] == [(0, 0), (2, 1)]
    assert desk.send(line_frame("#3 HELLO 1")) == ["OK 3 tacshade 1 crc=opt mode=BIN"]
    assert desk.send(frame(b"L#4 HELLO 1\n")) == ["OK 4 tacshade 1 crc=opt mode=BIN"]
    assert desk.send(line_frame("#5 MODE ASCII")) == ["OK 5 ASCII"]
    assert desk.send(b"#6 STATUS\n") == ["OK 6 name=done-2"]
    assert desk.link.mode == "ASCII"


def test_missing_and_repeated_poses_are_counted_by_their_numbers() -> None:
    desk = Desk()
    desk.send(
        b"#1 MODE BIN\n"
        + b"".join(frame(pose(seq)) for seq in (65533, 65535, 65535, 65533, 2, 40000, 40001))
    )
    assert [p.missing for p in desk.poses] == [0, 1, 2, 0, 0]
    counts = desk.link.counts
    assert (counts.poses, counts.poses_lost, counts.poses_repeated) == (5, 3, 2)


def test_bad_poses_are_reported_once_a_second() -> None:
    desk = Desk()
    bad = b"#5 POSE 1 0 0 0 9 0 0 0\n"
    assert desk.send(bad * 10, 0) == [
        "ERR 5 ARGS POSE: found a quaternion of length 9, expected length 1"
    ]
    assert desk.send(bad, 999_999_999) == []
    assert len(desk.send(bad, 1_000_000_000)) == 1
    assert desk.link.counts.poses_bad == 12
    desk.send(b"#1 MODE BIN\n")
    assert desk.send(frame(encode_pose(PoseSample(1, 1, (9e9, 0, 0, 1, 0, 0, 0)))), 2_000_000_000)[
        0
    ].startswith("ERR")
    desk.send(frame(bytes([pose(1)[0], 9]) + pose(1)[2:]))
    assert (desk.link.counts.poses_bad, desk.link.counts.damaged) == (13, 1)


def test_a_lost_port_ends_a_line_and_nothing_else() -> None:
    desk = Desk()
    desk.send(b"#1 HELLO 1\n#2 CAPTURE\n#3 CAPT")
    desk.link.interrupted()
    assert desk.send(b"URE\n#2 CAPTURE\n") == [
        f"ERR - VERB found URE, expected one of {' '.join(USAGE)}",
        "OK 2 name=done-1",
    ]
    assert desk.link.counts.garbage_bytes == len("#3 CAPT")


def test_a_reply_is_one_line_whatever_is_in_it() -> None:
    desk = Desk()
    desk.send(b"#1 CAPTURE\n", answer=False)
    desk.link.answer(desk.done[0], SessionBegun("a\nb*c\u00e9" + "x" * 500))
    (said,) = texts(desk.link.take_output())
    assert said.startswith("OK 1 name=a?b?c?xxx")


def chunks(data: bytes, rng: random.Random, mean: int = 40) -> list[bytes]:
    cuts = sorted(rng.randrange(len(data) + 1) for _ in range(len(data) // mean + 1))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def session(rng: random.Random, commands: int) -> list[bytes]:
    """Numbered lines with checksums, with poses between them."""
    verbs = ["CAPTURE", "REFERENCE", "STITCH ADD", "STATUS", "SYNC 12345"]
    lines = []
    for seq in range(2, 2 + commands):
        lines.append(seal(f"#{seq} {rng.choice(verbs)}"))
        lines.append(seal(f"#{seq} POSE {seq * 1000} 1 2 3 1 0 0 0"))
    return lines


def mangled(line: bytes, rng: random.Random) -> bytes:
    kind = rng.randrange(4)
    at = rng.randrange(len(line))
    if kind == 0:
        return line[:at]
    if kind == 1:
        return line[:at] + bytes([line[at] ^ 1 << rng.randrange(8)]) + line[at + 1 :]
    if kind == 2:
        return line[:at] + rng.randbytes(rng.randrange(1, 6)) + line[at:]
    return line[:at] + line[at + rng.randrange(1, 6) :]


@pytest.mark.parametrize("binary", [False, True], ids=["ASCII", "BIN"])
@settings(max_examples=15)
@given(seed=st.integers(0, 2**32))
def test_a_session_cut_repeated_reordered_and_damaged_is_done_once(binary: bool, seed: int) -> None:
    """A robot that repeats each line until its reply has arrived,
    over a line that loses half of both.
    """
    rng = random.Random(seed)
    desk = Desk()
    desk.send(seal("#1 HELLO 1 crc=req boot=a") + (seal("#0 MODE BIN") if binary else b""))
    wanted = session(rng, 40)
    acknowledged: dict[int, str] = {}
    asked = {int(line[1 : line.index(b" ")]): line for line in wanted if b"POSE" not in line}
    late: list[bytes] = []
    while len(acknowledged) < len(asked):
        open_ones = [line for seq, line in asked.items() if seq not in acknowledged][:8]
        batch = [rng.choice([line, mangled(line, rng)]) for line in open_ones + late]
        batch += [*rng.sample(wanted, 3), seal("#1 HELLO 1 crc=req boot=a")]
        late = rng.sample(open_ones, min(3, len(open_ones)))
        rng.shuffle(batch)
        packed = b"".join(frame(b"L" + raw.rstrip(b"\n")) if binary else raw for raw in batch)
        for piece in chunks(packed + (b"\0" if binary else b"\n"), rng):
            for said in desk.send(piece):
                word, seq, *_ = said.split(" ", 2)
                if word == "OK" and int(seq) in asked and rng.random() < 0.5:
                    assert acknowledged.setdefault(int(seq), said) == said
    done = [command.seq for command in desk.done]
    assert sorted(done) == sorted(set(done)) == sorted(asked)  # each once
    for command in desk.done:
        assert asked[command.seq or 0].startswith(f"#{command.seq} {command.verb}".encode())


_WORD = st.sampled_from(
    (
        "1",
        "0",
        "-1",
        "nan",
        "1e300",
        "x",
        "../x",
        "crc=req",
        "boot=b",
        "BEGIN",
        "ADD",
        "END",
        "é",
        "",
    )
)
_VERB = st.sampled_from(
    ("HELLO", "SYNC", "POSE", "CAPTURE", "REFERENCE", "STATUS", "HELP", "STITCH", "TOUCH", "NOPE")
)
_LINE = st.builds(
    lambda seq, verb, words: " ".join((seq, verb, *words)),
    st.sampled_from(("", "#7", "#70000")),
    _VERB,
    st.lists(_WORD),
)


@given(
    st.lists(
        st.binary(max_size=80)
        | _LINE.map(lambda line: line.encode())
        | _LINE.filter(str.isascii).map(seal)
    )
)
def test_whatever_comes_gets_sound_answers_and_a_greeting_is_heard_after_it(
    pieces: list[bytes],
) -> None:
    desk = Desk()
    for piece in pieces:
        desk.send(piece + b"\n")
    assert any(said.startswith("OK 9") for said in desk.send(b"\n" + seal("#9 HELLO 1")))
