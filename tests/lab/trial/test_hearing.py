"""What a listener has heard, in numbers."""

from __future__ import annotations

import math
from typing import Any

from tacshade_edge.lab.trial.hearing import Heard

S = 1_000_000_000
MS = 1_000_000


def health(captured: int, lost: int) -> dict[str, Any]:
    frames = {"captured": captured, "superseded": lost, "failed": 0}
    return {"frames": frames, "source_dropped": 1}


def test_ages_are_those_after_the_start_of_each_sensor() -> None:
    messages = {
        "a": [("height", 0, 0, 90 * MS), ("height", 1, 3 * S, 3 * S + 5 * MS)],
        "b": [("height", 7, 9 * S, 9 * S + 80 * MS), ("height", 8, 12 * S, 12 * S + 7 * MS)],
    }
    heard = Heard(messages)
    assert heard.ages_ms() == [5, 7]
    assert heard.percentile_ms(0.5) == 6
    assert math.isnan(Heard({"a": []}).percentile_ms(0.5))


def test_frames_lost_in_the_first_second_are_those_of_a_start() -> None:
    first = [
        (0, health(0, 0)),
        (S, health(10, 5)),
        (2 * S, health(70, 9)),
        (5 * S, health(250, 11)),
    ]
    other = [(S, health(1, 1)), (3 * S, health(60, 1))]
    # The camera's own drops count as captured: nobody else saw these frames.
    assert Heard(health={"a": first, "b": other}).frames() == (180, 2)
