from __future__ import annotations

import io

import pytest

from tacshade_edge.cli.shared.progress import Progress, duration


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


class Clock:
    now_s = 1000.0

    def __call__(self) -> float:
        return self.now_s


def counted(stream: io.StringIO, total: int | None = 30) -> str:
    """What is written of thirty images that take 1 s each."""
    clock = Clock()
    progress = Progress(stream, clock)
    for done in range(31):
        progress("images", done, total)
        clock.now_s += 1
    progress.end()
    return stream.getvalue()


def test_in_a_pipe_it_is_a_line_every_ten_seconds() -> None:
    lines = ["images: 10/30, 20 s left", "images: 20/30, 10 s left", "images: 30/30"]
    assert counted(io.StringIO()).splitlines() == lines
    assert counted(io.StringIO(), None).splitlines() == ["images: 10", "images: 20", "images: 30"]


def test_on_a_terminal_it_is_one_line_that_renews_itself() -> None:
    written = counted(Terminal())
    assert written.count("\n") == 1
    assert written.endswith("images: 29/30, 1 s left\r\033[Kimages: 30/30\n")


def test_what_is_short_says_nothing_in_a_pipe() -> None:
    stream, clock = io.StringIO(), Clock()
    progress = Progress(stream, clock)
    for what in ("images", "profiles"):
        for done in range(3):
            progress(what, done, 2)
            clock.now_s += 4
    assert stream.getvalue() == ""


def test_a_message_stands_on_a_line_of_its_own() -> None:
    for stream, said in ((Terminal(), "\r\033[Ktacshade-edge: a.png: cut\n"), (io.StringIO(), "a.png: cut\n")):
        progress = Progress(stream, Clock())
        progress("images", 1, 2)
        progress.warn("a.png: cut")
        progress.end()
        assert stream.getvalue().endswith(said)
        assert "\n\n" not in stream.getvalue()


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0 s"), (89, "89 s"), (90, "2 min"), (3599, "1 h 0 min"), (7500, "2 h 5 min")]
)
def test_durations(seconds: float, text: str) -> None:
    assert duration(seconds) == text
