"""What the shares that maps leave unexplained say of pictures."""

from __future__ import annotations

from pathlib import Path

from tacshade_edge.doctor.judged_pictures import doubts

A, B, C = Path("a.png"), Path("b.png"), Path("c.png")


def test_pictures_of_another_sensor_are_one_line_and_a_failure() -> None:
    assert doubts({A: 1.2, B: 1.0, C: 0.4}) == (
        [
            "maps leave 40 to 120 % of 3 pictures' changes unexplained",
            "2 of 3 maps explain their pictures no better than no contact: are these pictures of "
            "this calibration's sensor?",
        ],
        True,
    )


def test_single_pictures_are_named() -> None:
    assert doubts({A: 1.2, B: 0.3, C: 0.4}) == (
        [
            "maps leave 30 to 120 % of 3 pictures' changes unexplained",
            "a.png: its map explains the picture no better than no contact (120 % left)",
        ],
        False,
    )
    lines, failed = doubts({A: 1.5})
    assert lines[-1].startswith("a.png: ")
    assert not failed
    assert doubts({}) == ([], False)
