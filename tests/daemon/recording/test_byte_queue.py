from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.daemon.record import ByteQueue


@given(st.lists(st.tuples(st.integers(1, 15), st.booleans()), max_size=40))
def test_every_item_is_taken_in_order_or_counted_and_the_limit_holds(steps: list[tuple[int, bool]]) -> None:
    queue: ByteQueue[tuple[int, int]] = ByteQueue(20)
    taken: list[tuple[int, int]] = []
    held = 0
    for number, (size, take) in enumerate(steps):
        before = queue.refused
        queue.put((number, size), size)
        held += size if queue.refused == before else 0
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
    assert len(taken) + queue.refused == len(steps)


def test_an_item_of_any_size_fits_an_empty_queue_and_a_reserve_is_for_its_kind() -> None:
    queue: ByteQueue[str] = ByteQueue(10)
    queue.put("huge", 99)
    queue.put("a", 1)
    assert (len(queue), queue.refused) == (1, 1)
    queue.put("event", 1, reserve_bytes=90)
    assert [queue.take(0), queue.take(0), queue.take(0)] == ["huge", "event", None]


def test_a_closed_queue_ignores_what_comes_and_gives_what_is_there() -> None:
    queue: ByteQueue[str] = ByteQueue(10)
    queue.put("a", 1)
    queue.close()
    queue.put("b", 1)
    assert (queue.refused, queue.drained) == (0, False)
    assert [queue.take(5), queue.take(5)] == ["a", None]
    assert queue.drained
