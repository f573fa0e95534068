"""The messages that the hand would have published for frames with their own times."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Mapping

from tacshade_edge.hand.aggregator import HandAggregator
from tacshade_edge.protocol.hand import Finger, HandObjects

Reports = Iterable[tuple[int, int, Finger]]
"""A finger's `t_ns`, Unix time and report of each frame, in order."""


def messages(fingers: Mapping[str, Reports]) -> Iterator[HandObjects]:
    """Combine the fingers' reports into messages, each made exactly when it is due.

    Parameters
    ----------
    fingers : mapping of str to iterable
        By sensor id; all times are of one clock.
    """
    aggregator = HandAggregator(tuple(fingers))
    reports = heapq.merge(*(_named(name, own) for name, own in fingers.items()), key=lambda report: report[0])
    now_ns = wall_minus_t_ns = 0
    for t_ns, wall_ns, name, finger in reports:
        aggregator.listen(True, t_ns)
        while (due_ns := aggregator.due_ns()) is not None and due_ns < t_ns:
            now_ns = max(now_ns, due_ns)
            yield aggregator.message(now_ns, now_ns + wall_minus_t_ns)
        now_ns, wall_minus_t_ns = t_ns, wall_ns - t_ns
        aggregator.hear(name, finger, t_ns)
    if (due_ns := aggregator.due_ns()) is not None:
        now_ns = max(now_ns, due_ns)
        yield aggregator.message(now_ns, now_ns + wall_minus_t_ns)


def _named(name: str, reports: Reports) -> Iterator[tuple[int, int, str, Finger]]:
    for t_ns, wall_ns, finger in reports:
        yield t_ns, wall_ns, name, finger
