from __future__ import annotations

import threading

from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.daemon.pipeline import Mailbox
from tools.testbed.patience import patience


@given(st.lists(st.sampled_from(["put", "take", "close"]), max_size=30))
def test_every_item_is_taken_replaced_or_refused_exactly_once(actions: list[str]) -> None:
    box: Mailbox[int] = Mailbox()
    taken: list[int] = []
    returned: list[int] = []
    count, full, closed = 0, False, False
    for action in actions:
        if action == "put":
            back = box.put(count)
            assert back == (count if closed else count - 1 if full else None)
            returned += [] if back is None else [back]
            full = full or not closed
            count += 1
        elif action == "take" and (full or closed):  # else it would wait
            item = box.take()
            assert (item is not None) is full
            taken += [] if item is None else [item]
            full = False
        elif action == "close":
            box.close()
            closed = True
    box.close()
    while (item := box.take()) is not None:
        taken.append(item)
    assert sorted(taken + returned) == list(range(count))
    assert taken == sorted(taken)


def test_a_slow_taker_sees_rising_items_and_the_last_one() -> None:
    box: Mailbox[int] = Mailbox()
    taken: list[int] = []
    replaced: list[int] = []

    def take() -> None:
        while (item := box.take()) is not None:
            taken.append(item)

    taker = threading.Thread(target=take)
    taker.start()
    for i in range(20_000):
        back = box.put(i)
        if back is not None:
            replaced.append(back)
    box.close()
    taker.join(patience(10))
    assert not taker.is_alive()
    assert taken[-1] == 19_999
    assert sorted(taken + replaced) == list(range(20_000))
    assert taken == sorted(taken)


def test_close_wakes_a_waiting_taker() -> None:
    box: Mailbox[int] = Mailbox()
    got: list[int | None] = []
    taker = threading.Thread(target=lambda: got.append(box.take()))
    taker.start()
    box.close()
    taker.join(patience(10))
    assert got == [None]
