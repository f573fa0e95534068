"""A hand's messages from frames with times of their own."""

from __future__ import annotations

from tacshade_edge.hand import GATHER_NS, STALLED_NS, messages
from tacshade_edge.protocol.topics import Finger

PERIOD_NS = 33_333_333


def reports(*states: str, late_ns: int = 0) -> list[tuple[int, int, Finger]]:
    times = (10**9 + late_ns + k * PERIOD_NS for k in range(len(states)))
    return [(t_ns, t_ns + 7, Finger(state=state, t_ns=t_ns, seq=0)) for t_ns, state in zip(times, states, strict=True)]  # type: ignore[arg-type]


def test_frames_of_one_moment_are_one_message() -> None:
    touch = ("contact",) * 5
    made = list(messages({"thumb": reports(*touch), "index": reports(*touch, late_ns=GATHER_NS // 2)}))
    assert [m.seq for m in made] == list(range(5))
    for message in made:
        thumb, index = message.fingers.values()
        assert (thumb.t_ns, index.t_ns) == (message.t_ns - GATHER_NS // 2, message.t_ns)
        assert message.wall_ns == message.t_ns + 7


def test_a_finger_whose_recording_ended_is_away() -> None:
    many = ("contact",) * (2 * STALLED_NS // PERIOD_NS)
    *_, last = messages({"thumb": reports(*many), "index": reports("contact")})
    assert [finger.state for finger in last.fingers.values()] == ["contact", "away"]


def test_no_frame_is_no_message() -> None:
    assert list(messages({"thumb": [], "index": []})) == []
