from __future__ import annotations

from tacshade_edge.daemon.session_worker import ADD_TIMEOUT_NS, WAITING_MAX, PendingAdds
from tacshade_edge.protocol.results import SessionResult
from tacshade_edge.reasons import Reason, ReasonCode


class Caller:
    """Notes what it is answered."""

    def __init__(self) -> None:
        self.codes: list[ReasonCode] = []

    def __call__(self, outcome: SessionResult | Reason) -> None:
        assert isinstance(outcome, Reason)
        self.codes.append(outcome.code)


def test_a_frame_is_for_those_who_waited_before_it_was_taken() -> None:
    adds, early, late = PendingAdds(), Caller(), Caller()
    adds.put(10, early)
    adds.put(20, late)
    assert adds.take(9) == []
    assert adds.take(15) == [early]
    assert adds.take(20) == [late]
    assert (len(adds), early.codes, late.codes) == (0, [], [])


def test_who_waits_in_vain_is_refused() -> None:
    adds, early, late = PendingAdds(), Caller(), Caller()
    adds.put(0, early)
    adds.put(1, late)
    adds.expire(ADD_TIMEOUT_NS)
    assert (early.codes, late.codes) == ([], [])
    adds.expire(ADD_TIMEOUT_NS + 1)
    assert (early.codes, late.codes) == ([ReasonCode.TIMEOUT], [])
    adds.refuse_all(Reason(ReasonCode.NO_SESSION, "the session has ended"))
    assert late.codes == [ReasonCode.NO_SESSION]
    assert len(adds) == 0


def test_too_many_are_refused_at_once() -> None:
    adds, callers = PendingAdds(), [Caller() for _ in range(WAITING_MAX + 1)]
    for caller in callers:
        adds.put(0, caller)
    assert callers[-1].codes == [ReasonCode.BUSY]
    assert adds.take(0) == callers[:-1]
