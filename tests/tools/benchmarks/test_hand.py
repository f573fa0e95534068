"""The benchmark of a hand: how old its messages are."""

from __future__ import annotations

from tacshade_edge.protocol.hand import Finger, HandObjects
from tools.benchmarks.hand import ages


def test_the_newest_frame_counts_once_and_beside_its_own_message() -> None:
    def hand(seq: int, thumb_ns: int, index_ns: int) -> HandObjects:
        thumb = Finger(state="contact", t_ns=thumb_ns, seq=thumb_ns // 10**6)
        index = Finger(state="contact", t_ns=index_ns, seq=index_ns // 10**6)
        free = Finger(state="free", t_ns=99 * 10**6, seq=99)
        return HandObjects(t_ns=0, wall_ns=0, seq=seq, fingers={"thumb": thumb, "index": index, "ring": free})

    heard = [
        (13_000_000, hand(0, 2_000_000, 5_000_000)),
        (14_000_000, hand(1, 2_000_000, 5_000_000)),  # nothing new
        (31_000_000, hand(2, 22_000_000, 5_000_000)),
        (36_000_000, hand(3, 22_000_000, 25_000_000)),
    ]
    own_ns = {("index", 5): 9_000_000, ("thumb", 22): 31_500_000, ("thumb", 25): 0}
    assert ages(heard, own_ns) == ([8.0, 9.0, 11.0], [4.0, -0.5])
