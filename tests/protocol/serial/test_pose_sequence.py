from __future__ import annotations

import pytest

from tacshade_edge.protocol.serial.pose_sequence import POSES_BEHIND, PoseSequence


@pytest.mark.parametrize(
    ("numbers", "missing"),
    [
        ([5, 6, 9], [0, 0, 2]),
        ([65534, 65535, 0, 2], [0, 0, 0, 1]),
        ([5, 5, 4, 6], [0, None, None, 0]),
        ([100, 100 - POSES_BEHIND, 101 - POSES_BEHIND], [0, 0, 0]),  # too old to come again: it counts anew
        ([5, None, 7], [0, 0, 1]),
    ],
)
def test_missing_between_two(numbers: list[int | None], missing: list[int | None]) -> None:
    sequence = PoseSequence()
    assert [sequence.missing_before(seq) for seq in numbers] == missing
