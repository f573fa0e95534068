"""The log, the progress and what a study lacks."""

from __future__ import annotations

import argparse
import io
import logging
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.logs import AT_ONCE, PERIOD_S, Limit, OneLineHandler
from tacshade_edge.cli.shared.progress import Progress

Written = tuple[logging.Logger, OneLineHandler, io.StringIO]


@pytest.fixture
def written() -> Iterator[Written]:
    logger, handler, stream = logging.Logger("test"), OneLineHandler(), io.StringIO()
    handler.setStream(stream)
    logger.addHandler(handler)
    yield logger, handler, stream
    handler.close()


def test_text_from_outside_cannot_forge_a_line_or_make_a_long_one(written: Written) -> None:
    logger, _, stream = written
    logger.info("req/%s refused", "a\nWARNING root: all is lost\x1b[2J\u2028\u202e")
    try:
        raise ValueError("b\nWARNING root: all is lost\x1b[2J")
    except ValueError:
        logger.exception("it failed")
    lines = stream.getvalue().splitlines()
    assert lines[:2] == [
        r"INFO test: req/a\nWARNING root: all is lost\x1b[2J\u2028\u202e refused",
        "ERROR test: it failed",
    ]
    assert all(line.startswith("    ") for line in lines[2:])
    assert all(line.isprintable() for line in lines)
    logger.info("%s", "x" * 10**6)
    assert len(stream.getvalue().splitlines()[-1]) < 1100


def test_a_flood_is_counted_and_hides_nothing(written: Written) -> None:
    logger, handler, stream = written
    for number in range(15_000):
        logger.info("req/%s refused: %d", "profile", number)
    logger.info("another")
    assert len(stream.getvalue().splitlines()) == AT_ONCE + 1
    handler.close()
    reported = (
        f"WARNING test: left out {15_000 - AT_ONCE} more lines like this: req/profile refused: #"
    )
    assert stream.getvalue().splitlines()[-1] == reported


def test_a_fault_is_not_hidden_by_another_of_the_same_format(written: Written) -> None:
    logger, handler, stream = written
    faults = [
        "/dev/video0: unplugged",
        "/dev/video2: unplugged",
        "disk full",
        "no 10.0.0.1",
        "no 10.0.0.2",
    ]
    for fault in faults:
        for _ in range(20):
            logger.warning("%s", fault)
    lines = stream.getvalue().splitlines()
    assert [lines.count(f"WARNING test: {fault}") for fault in faults] == [AT_ONCE] * len(faults)
    handler.close()
    left_out = [f"WARNING test: left out 10 more lines like this: {fault}" for fault in faults]
    assert stream.getvalue().splitlines()[len(lines) :] == left_out


def test_texts_without_end_are_bounded_and_hide_no_other_format() -> None:
    limit = Limit()
    assert sum(limit.passes(("a", "%s", f"x{k}"), 0.0) for k in range(2_000)) == 16 + AT_ONCE
    assert limit.passes(("a", "another %s", "another"), 0.0)
    assert limit.passes(
        ("a", "%s", "later"), 2 * PERIOD_S
    )  # the texts that were quiet meanwhile are forgotten
    # Formats that are made, each another: each that is remembered passes, the others count as one.
    assert sum(limit.passes(("c", str(k), str(k)), 0.0) for k in range(2_000)) <= 300


LOGS = """
import argparse, logging, sys
sys.modules["systemd"] = None  # tests/cli/test_journal.py has the package
from tacshade_edge.cli.shared.logs import add_verbosity, start_logging
parser = argparse.ArgumentParser()
add_verbosity(parser)
start_logging(parser.parse_args(sys.argv[1:]).log_level)
for level in (logging.DEBUG, logging.INFO, logging.WARNING):
    logging.getLogger("test").log(level, "said")
"""


def logged(*words: str, journal: bool = False) -> list[str]:
    """What a process with these words logs, to a file that is the journal's or not."""
    with tempfile.TemporaryFile("w+") as stream:
        found = os.fstat(stream.fileno())
        # A shell below a service inherits the variable: only the very stream counts.
        inode = found.st_ino if journal else found.st_ino + 1
        environment = os.environ | {"JOURNAL_STREAM": f"{found.st_dev}:{inode}"}
        subprocess.run(
            [sys.executable, "-c", LOGS, *words], stderr=stream, env=environment, check=True
        )
        stream.seek(0)
        return stream.read().splitlines()


@pytest.mark.slow
def test_the_journal_gets_priorities_for_time_stamps_and_a_word_more_or_less() -> None:
    assert logged(journal=True) == ["<6>INFO test: said", "<4>WARNING test: said"]
    stamp = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d"
    for line, said in zip(logged(), ("INFO test: said", "WARNING test: said"), strict=True):
        assert re.fullmatch(f"{stamp} {said}", line)
    words = [line.split()[0] for line in logged("-v", journal=True)]
    assert words == ["<7>DEBUG", "<6>INFO", "<4>WARNING"]
    assert [line.split()[0] for line in logged("-q", journal=True)] == ["<4>WARNING"]


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
    lines = ["images: 10/30, 20 s left", "images: 20/30, 10 s left", "images: 30/30, 0 s left"]
    assert counted(io.StringIO()).splitlines() == lines
    assert counted(io.StringIO(), None).splitlines() == ["images: 10", "images: 20", "images: 30"]


def test_on_a_terminal_it_is_one_line_that_renews_itself() -> None:
    written = counted(Terminal())
    assert written.count("\n") == 1
    assert written.endswith("images: 29/30, 1 s left\r\033[Kimages: 30/30, 0 s left\n")


def test_a_message_stands_on_a_line_of_its_own() -> None:
    for stream, said in (
        (Terminal(), "\r\033[Ktacshade-edge: a.png: cut\n"),
        (io.StringIO(), "a.png: cut\n"),
    ):
        progress = Progress(stream, Clock())
        progress("images", 1, 2)
        progress.warn("a.png: cut")
        progress.end()
        assert stream.getvalue().endswith(said)
        assert "\n\n" not in stream.getvalue()


def test_without_matplotlib_the_plots_are_missing_and_a_line_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    args = argparse.Namespace(out=tmp_path)
    assert study.will_draw(args, "tradeoff.png")
    assert capsys.readouterr().err == ""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert not study.will_draw(args, "tradeoff.png")
    install = "pip install '.[studies]' in the clone"
    assert (
        capsys.readouterr().err
        == f"tacshade-edge: tradeoff.png will be missing without matplotlib: {install}\n"
    )
    assert not study.will_draw(argparse.Namespace(out=None), "tradeoff.png")
    assert capsys.readouterr().err == ""
