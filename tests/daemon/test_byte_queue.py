"""Tests of the queue that is bounded in bytes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.daemon.byte_queue import ByteQueue


@given(st.lists(st.tuples(st.integers(1, 15), st.booleans()), max_size=40))
def test_every_item_is_taken_in_order_or_counted_and_the_limit_holds(
    steps: list[tuple[int, bool]],
) -> None:
    queue: ByteQueue[tuple[int, int]] = ByteQueue(20)
    taken: list[tuple[int, int]] = []
    held = refused = 0
    for number, (size, take) in enumerate(steps):
        fitted = queue.put((number, size), size)
        held += size if fitted else 0
        refused += not fitted
        assert held <= 20
        if take and (item := queue.take(0)) is not None:
            taken.append(item)
            held -= item[1]
    queue.close()
    while not queue.drained:
        item = queue.take(0)
        assert item is not None
        taken.append(item)
    assert taken == sorted(taken)
    assert len(taken) + refused == len(steps)


def test_an_item_of_any_size_fits_an_empty_queue_and_a_reserve_is_for_its_kind() -> None:
    queue: ByteQueue[str] = ByteQueue(10)
    assert queue.put("huge", 99)
    assert not queue.put("a", 1)
    assert queue.put("event", 1, reserve_bytes=90)
    assert queue.put("end", 0)
    assert [queue.take(0) for _ in range(4)] == ["huge", "event", "end", None]
