"""The benchmark of a held object's motion."""

from __future__ import annotations

import pytest

from tools.benchmarks.object_motion import main, measure


def test_every_message_is_counted_and_has_the_motion() -> None:
    _, messages, bare = measure(2, 60, 0.5, False, False)
    _, again, moved = measure(2, 60, 0.5, False, True)
    assert messages == again == pytest.approx(60, abs=2)
    assert moved > bare + 2 * 200


def test_it_prints_each_way(capsys: pytest.CaptureFixture[str]) -> None:
    main(["--seconds", "0.1"])
    assert capsys.readouterr().out.count("together") == 2
