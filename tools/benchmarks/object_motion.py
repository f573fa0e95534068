"""Measure what tracking a held object costs a hand's process: messages of five fingers, with shear and without.

::

    .venv/bin/python -m tools.benchmarks.object_motion [--fingers 5] [--fps 60] [--seconds 20]

Fingers around a cylinder report every frame, simultaneously or one after the other, to the part of the hand's process
that assembles its message. CPU is a share of one core and includes encoding, but not the fingers' lines or the broker.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence

from tacshade_edge.hand.aggregator import HandAggregator
from tacshade_edge.protocol.hand import Finger, HandObject, encode_hand
from tacshade_edge.studies.tables import markdown

BEGIN_NS = 10**12


def finger(k: int, of: int, t_ns: int, shear: bool) -> Finger:
    """Finger `k` on a cylinder along z that moves to and fro along z once a second."""
    c, s = math.cos(2 * math.pi * k / of), math.sin(2 * math.pi * k / of)
    inward = (-c, -s, 0.0)
    held = HandObject(
        id=1,
        centroid_mm=(20 * c, 20 * s, 5.0 * k),
        extent_mm=(5.0, 5.0, 1.0),
        normal=inward,
        depth_max_mm=2.0,
        area_mm2=20.0,
        shear_mm=(0.0, 0.0, math.sin(2e-9 * math.pi * t_ns)) if shear else None,
        twist_deg=0.0,
        slip=0,
        slip_mm_s=0.0,
    )
    return Finger(state="contact", t_ns=t_ns, seq=1, axis=inward, objects=(held,))


def measure(count: int, fps: int, seconds: float, apart: bool, shear: bool) -> tuple[float, float, int]:
    """Percent of a core, messages per second, and bytes of the last message."""
    hand = HandAggregator([f"{k}" for k in range(count)])
    hand.listen(True, BEGIN_NS)
    period_ns = 1_000_000_000 // fps
    spent_ns = messages = size = 0
    for i in range(round(fps * seconds)):
        for k in range(count):
            now_ns = BEGIN_NS + i * period_ns + (k * period_ns // count if apart else 0)
            reported = finger(k, count, now_ns, shear)
            began_ns = time.process_time_ns()
            hand.hear(f"{k}", reported, now_ns)
            if (due_ns := hand.due_ns()) is not None and due_ns <= now_ns:
                size = len(encode_hand(hand.message(now_ns, 0)))
                messages += 1
            spent_ns += time.process_time_ns() - began_ns
    return spent_ns / (1e7 * seconds), messages / seconds, size


def main(words: Sequence[str] | None = None) -> None:
    """Print a row for each case."""
    parser = argparse.ArgumentParser(description="What the motion of a held object costs.")
    parser.add_argument("--fingers", type=int, default=5)
    parser.add_argument("--fps", type=int, default=60)
    parser.add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args(words)
    lines = []
    for apart in (False, True):
        for shear in (False, True):
            core, messages, size = measure(args.fingers, args.fps, args.seconds, apart, shear)
            what = f"{'one after the other' if apart else 'together'}, {'motion' if shear else 'no shear'}"
            lines.append((what, f"{core:.2f}", f"{messages:.0f}", f"{size}"))
    print(markdown(("what", "% of a core", "messages/s", "bytes"), lines))


if __name__ == "__main__":
    main()
