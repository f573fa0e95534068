from __future__ import annotations

import pytest

from tacshade_edge.protocol.serial.replies import REPLIES_KEPT, Repeat, ReplyCache
from tacshade_edge.protocol.serial.verbs import Command
from tacshade_edge.reasons import Reason, ReasonCode


def command(seq: int) -> Command:
    return Command(seq, "CAPTURE", (), 0)


def code(outcome: Repeat | Reason | None) -> ReasonCode:
    assert isinstance(outcome, Reason)
    return outcome.code


def test_a_number_is_admitted_once() -> None:
    cache, first = ReplyCache(), command(7)
    assert cache.admit(7, "#7 CAPTURE", first) is None
    assert cache.admit(7, "#7 CAPTURE", command(7)) == Repeat(None)
    assert cache.keep(7, first, "OK 7")
    assert cache.admit(7, "#7 CAPTURE", command(7)) == Repeat("OK 7")
    assert code(cache.admit(7, "#7 STATUS", command(7))) == ReasonCode.NUMBER_REUSED


def test_a_reply_to_a_forgotten_command_is_not_kept() -> None:
    cache, first = ReplyCache(), command(7)
    assert not cache.keep(7, first, "OK 7")
    cache.admit(7, "#7 CAPTURE", command(7))
    assert not cache.keep(7, first, "OK 7")
    assert cache.admit(7, "#7 CAPTURE", command(7)) == Repeat(None)


@pytest.mark.parametrize("newest", [REPLIES_KEPT + 30, 30])  # the second goes round
def test_numbers_older_than_the_replies_are_stale(newest: int) -> None:
    cache = ReplyCache(newest)
    stale, kept = ((newest - behind) % 65536 for behind in (REPLIES_KEPT, REPLIES_KEPT - 1))
    assert code(cache.admit(stale, "", None)) == ReasonCode.NUMBER_STALE
    assert cache.admit(kept, "", None) is None
