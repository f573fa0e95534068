"""Every message with another text: what is decided must not change."""

from __future__ import annotations

import pytest

from tacshade_edge.errors import TacshadeError
from tacshade_edge.reasons import Reason, ReasonCode

# Misleading on purpose, for what still looks into texts.
NONSENSE = "torn: size, busy, automatic, expired, time"


def reword(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every `Reason` and every exception that is made from now on have the same text."""
    make_reason, make_error = Reason.__init__, TacshadeError.__init__

    def reason(self: Reason, code: ReasonCode, text: str) -> None:
        make_reason(self, code, NONSENSE)

    def error(self: TacshadeError, text: str, *, code: ReasonCode | None = None) -> None:
        make_error(self, NONSENSE, code=code)

    monkeypatch.setattr(Reason, "__init__", reason)
    monkeypatch.setattr(TacshadeError, "__init__", error)
