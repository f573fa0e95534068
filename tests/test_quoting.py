from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from tacshade_edge.quoting import escaped, quoted, shown


def test_what_a_terminal_would_obey_is_escaped() -> None:
    assert quoted("a\x1b[2J\nINFO all is well\u202e") == r"'a\x1b[2J\nINFO all is well\u202e'"
    assert shown(Path("a/b.png")) == "a/b.png"
    assert shown("a\nb") == r"'a\nb'"
    assert shown("x" * 9, 8) == "'xxxxxxxx…'"


@given(st.text(max_size=60), st.integers(1, 50))
def test_it_is_one_printable_line_of_bounded_length(text: str, most: int) -> None:
    for line in (quoted(text, most), shown(text, most), escaped(text, most)):
        assert line.isprintable()
        assert len(line) <= 10 * most + 3  # \\U0001f600
    assert escaped(text, most) == text or not text.isprintable() or len(text) > most
