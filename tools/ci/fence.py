#!/usr/bin/env python3
"""Keep functions and files small: no new violation of the rules below, and the old ones shrink.

::

    .venv/bin/python -m tools.ci.fence          # what is new, and what the baseline can let go
    .venv/bin/python -m tools.ci.fence --write  # write the baseline anew; refused if a rule grows

``lint_baseline.json`` counts what each file still violates. A file may have no more than that, and
must not have less: who cures one writes the baseline, so that it cannot come back. Files may be
renamed, as `--write` compares the sums over all files.
"""

from __future__ import annotations

import argparse
import ast
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BASELINE = Path(__file__).with_name("lint_baseline.json")
RULES = ("C901", "PLR0913", "PLR0915", "SLF001", "FBT", "PLR2004")
"""Of ruff, with the limits of pyproject.toml: branches, parameters and statements of a function,
private names of others, booleans by position, numbers without a name.
"""
FUNCTION_LINES_MAX = 50
FILE_LINES_MAX = 400
LONG_FUNCTION, LONG_FILE, UNFORMATTED = "long-function", "long-file", "fmt-skip"
_START = re.compile(r"( *)(?:async def|def|class|@)")
_UNFORMATTED = re.compile(r"# fmt: (?:skip|off)")

Counts = Counter[tuple[str, str]]
"""How often a file violates a rule."""


@dataclass(frozen=True, slots=True)
class Violation:
    """A rule that is violated at a line of a file; `times` more than once if by a multiple."""

    file: str
    line: int
    rule: str
    text: str
    times: int = 1


def main() -> int:
    """Compare what is found with the baseline, or write it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--write", action="store_true", help="write the baseline anew")
    args = parser.parse_args()
    found, known = [*of_ruff(ROOT), *of_lines(ROOT)], read(BASELINE)
    mistakes = grown(counted(found), known) if args.write else differences(found, known)
    if args.write and not mistakes:
        write(BASELINE, counted(found))
    print(*mistakes, sep="\n", end="\n" if mistakes else "")
    return int(bool(mistakes))


def of_ruff(root: Path) -> Iterator[Violation]:
    """What ruff finds of `RULES` below a folder; a link counts where it leads."""
    words = [sys.executable, "-m", "ruff", "check", "--exit-zero", "--output-format", "json"]
    command = [*words, "--select", ",".join(RULES), "."]
    done = subprocess.run(command, cwd=root, stdout=subprocess.PIPE, check=True)
    for each in json.loads(done.stdout):
        path = Path(each["filename"])
        if not path.is_symlink():
            file, line = path.relative_to(root).as_posix(), each["location"]["row"]
            yield Violation(file, line, each["code"], each["message"])


def of_lines(root: Path) -> Iterator[Violation]:
    """Functions and files that are too long, and lines that are kept from the formatter."""
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "*.py"]
    listed = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True).stdout
    for file in listed.splitlines():
        path = root / file
        if path.is_file() and not path.is_symlink():
            yield from in_file(file, path.read_text(encoding="utf-8"))


def in_file(file: str, text: str) -> Iterator[Violation]:
    """The violations of `of_lines` in one file."""
    lines = text.splitlines()
    if len(lines) > FILE_LINES_MAX:
        what = f"{len(lines)} lines, expected at most {FILE_LINES_MAX}"
        yield Violation(file, 1, LONG_FILE, what, _times(len(lines), FILE_LINES_MAX))
    for number, line in enumerate(lines, 1):
        if _UNFORMATTED.search(line):
            yield Violation(file, number, UNFORMATTED, "kept from the formatter")
    if not _may_have_long_function(lines):
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            length = (node.end_lineno or node.lineno) - node.lineno + 1
            if length > FUNCTION_LINES_MAX:
                what = f"`{node.name}` has {length} lines, expected at most {FUNCTION_LINES_MAX}"
                times = _times(length, FUNCTION_LINES_MAX)
                yield Violation(file, node.lineno, LONG_FUNCTION, what, times)


def _times(lines: int, most: int) -> int:
    """How many more pieces of at most so many lines it would make."""
    return (lines - 1) // most


def _may_have_long_function(lines: list[str]) -> bool:
    """Whether it is worth a parser's time: two starts at a level are far from each other."""
    open_at: dict[int, int] = {}
    ends = [(number, _START.match(line)) for number, line in enumerate(lines)]
    starts = [(number, len(start[1])) for number, start in ends if start]
    for number, indent in [*starts, (len(lines), 0)]:
        for level in [level for level in open_at if level >= indent]:
            if number - open_at.pop(level) > FUNCTION_LINES_MAX:
                return True
        open_at[indent] = number
    return False


def counted(found: list[Violation]) -> Counts:
    """How often each file violates each rule."""
    counts: Counts = Counter()
    for each in found:
        counts[each.file, each.rule] += each.times
    return counts


def differences(found: list[Violation], known: Counts) -> list[str]:
    """A line about all that is new, and about all that the baseline has too many."""
    counts, mistakes = counted(found), []
    for (file, rule), count in sorted((counts - known).items()):
        where = [each for each in found if (each.file, each.rule) == (file, rule)]
        mistakes += [f"{file}:{each.line}: {rule} {each.text}" for each in where]
        mistakes.append(f"{file}: {rule} found {counts[file, rule]}, {count} more than before")
    gone = sorted(known - counts)
    mistakes += [f"{file}: {rule} found {counts[file, rule]}, fewer now" for file, rule in gone]
    if gone:
        name = BASELINE.relative_to(ROOT)
        mistakes.append(f"to shrink {name}: .venv/bin/python -m tools.ci.fence --write")
    return mistakes


def grown(counts: Counts, known: Counts) -> list[str]:
    """A line about each rule that is violated more often than before, over all files."""
    now, before = _by_rule(counts), _by_rule(known)
    return [
        f"{rule}: found {now[rule]} in all files, expected at most {before[rule]}"
        for rule in sorted(now - before)
    ]


def _by_rule(counts: Counts) -> Counter[str]:
    sums: Counter[str] = Counter()
    for (_, rule), count in counts.items():
        sums[rule] += count
    return sums


def read(path: Path) -> Counts:
    """Read a baseline: for each file the rules that it violates, and how often."""
    files = json.loads(path.read_text(encoding="utf-8"))
    return Counter({(file, rule): n for file, rules in files.items() for rule, n in rules.items()})


def write(path: Path, counts: Counts) -> None:
    """Write a baseline, a line for each file, so that two branches seldom touch the same one."""
    files: dict[str, dict[str, int]] = {}
    for (file, rule), count in sorted(counts.items()):
        files.setdefault(file, {})[rule] = count
    lines = [f"{json.dumps(file)}: {json.dumps(rules)}" for file, rules in files.items()]
    path.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
