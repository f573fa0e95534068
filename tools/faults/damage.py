"""Damaged inputs, read in this process; each number always gives the same input.

Each input must give a value, or one of the program's three exceptions with one line. It must take at most
`MEMORY_MAX_MB` for the whole process and `WAIT_MAX_S`. A kind with a checksum must never give another value without a
warning.
"""

from __future__ import annotations

import json
import math
import multiprocessing
import os
import random
import resource
import shutil
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from tacshade_edge.errors import TacshadeError
from tools.faults import handed_in
from tools.faults.handed_in import Files, Kind, Read, warnings_kept
from tools.faults.handed_in_mcap import mcap_kinds
from tools.testbed.patience import stretched

MEMORY_MAX_MB = 400.0
WAIT_MAX_S = 5.0
LINE_CHARS_MAX = 2000
_HANGS_S = 60.0
_ADDRESS_SPACE = 4 << 30
"""Limit in bytes, so that an input that exhausts memory ends only its process."""
_JUNK: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2**31, 2**63, -(2**63), 2**64, 10**30),
    *(0.0, -0.0, 1e-300, 1e300, -1e300, math.nan, math.inf, -math.inf, 0.5, 45.0, 1e6),
    *("", "x", "20", "nan", "\x00", "\n\x1b[31mINFO", "../../x", "a" * 5000, "bright", "é\u2028"),
    *([], {}, [[]], [None], [0.0] * 7, [1e300] * 7, {"a": 1}, {"fast": 0.0}, ["x"] * 40),
)
_WORDS = (
    *("", "0", "-1", "1e300", "nan", "inf", "-0", "9" * 400, "0x10", "1_0", "null", "~", "yes", "[]", "{}", "[[[", "x"),
    *("&a [*a]", "*a", "!!python/object:os.system", "\t", "\x00", "\x1b[2J", "'", '"', ",", ":", "#", "- -", "é", "٣"),
)


@dataclass(slots=True)
class Outcome:
    """The outcome of all numbers so far."""

    counts: Counter[tuple[str, str]] = field(default_factory=Counter)
    problems: list[str] = field(default_factory=list)
    longest_s: float = 0.0
    most_mb: float = 0.0
    done: int = 0

    def add(self, other: Outcome) -> None:
        """Add another outcome's counts."""
        self.counts += other.counts
        self.problems += other.problems
        self.longest_s, self.most_mb = max(self.longest_s, other.longest_s), max(self.most_mb, other.most_mb)
        self.done += other.done


def make_kinds() -> dict[str, Kind]:
    """Make every kind of input."""
    return {**handed_in.make_kinds(), **mcap_kinds()}


def junk(draw: random.Random) -> Any:
    """Draw a value with a wrong type or outside every range."""
    return draw.choice(_JUNK)


def damaged(kind: Kind, draw: random.Random) -> tuple[Files, str]:
    """Damage files; also return the kind of damage."""
    if kind.sealed is not None and draw.random() < 0.4:
        return kind.sealed(draw, junk), "behind a right checksum"
    name = draw.choice(kind.damaged)
    way = draw.choice((*_WAYS, *_WORDS_WAYS) if kind.text or name.endswith((".csv", ".json")) else tuple(_WAYS))
    if draw.random() < 0.002:
        way = _grown
    data = kind.files[name]
    for _ in range(draw.choice((1, 1, 1, 2, 5))):
        data = way(data, draw)
    return {name: data}, way.__name__.strip("_")


def _flipped(data: bytes, draw: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 1, 2, 8))):
        if changed:
            changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def _flipped_early(data: bytes, draw: random.Random) -> bytes:
    """Flip bits in the headers."""
    return _flipped(data[:200], draw) + data[200:]


def _cut(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data) + 1)]


def _hole(data: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    return data[:at] + data[at + draw.randrange(1, 65) :]


def _twice(data: bytes, draw: random.Random) -> bytes:
    at, long = draw.randrange(len(data) + 1), draw.randrange(1, 257)
    return data[:at] + data[at : at + long] + data[at:]


def _strewn(data: bytes, draw: random.Random) -> bytes:
    at = draw.randrange(len(data) + 1)
    return data[:at] + draw.randbytes(draw.randrange(1, 65)) + data[at:]


def _zeros(data: bytes, draw: random.Random) -> bytes:
    at, long = draw.randrange(len(data) + 1), draw.randrange(1, 513)
    return data[:at] + bytes(len(data[at : at + long])) + data[at + long :]


def _other_number(data: bytes, draw: random.Random) -> bytes:
    """Replace four bytes by an impossible length or size."""
    at = draw.randrange(min(len(data), 400) + 1)
    return data[:at] + draw.choice((b"\xff" * 4, b"\xff\xff\xff\x7f", b"\x7f\xff\xff\xff", bytes(4))) + data[at + 4 :]


def _grown(data: bytes, draw: random.Random) -> bytes:
    """Replace a few bytes by megabytes."""
    at = draw.randrange(len(data) + 1)
    return data[:at] + draw.choice((b"[", b"1,", b"- 1\n", b"a: 1\n", b"\x00", b'"', b"\n")) * 500_000 + data[at:]


def _other_word(data: bytes, draw: random.Random) -> bytes:
    words = data.replace(b",", b" , ").replace(b"\n", b" \n ").split(b" ")
    words[draw.randrange(len(words))] = draw.choice(_WORDS).encode()
    return b" ".join(words).replace(b" , ", b",").replace(b" \n ", b"\n")


def _other_line(data: bytes, draw: random.Random) -> bytes:
    lines = data.split(b"\n")
    at = draw.randrange(len(lines))
    other = draw.choice((b"", lines[draw.randrange(len(lines))], draw.choice(_WORDS).encode()))
    return b"\n".join((*lines[:at], other, *lines[at + draw.randrange(2) :]))


_WAYS = (_flipped, _flipped_early, _cut, _hole, _twice, _strewn, _zeros, _other_number)
_WORDS_WAYS = (_other_word, _other_word, _other_word, _other_word, _other_line, _other_line)


def read(kind: Kind, folder: Path) -> Read:
    """Read a folder as the program does, and keep the result."""
    with warnings_kept() as warnings:
        try:
            found = Read(kind.read(folder))
        except TacshadeError as error:
            found = Read(error=str(error) or "an error without a text")
    found.told = warnings.lines
    return found


def judged(kind: Kind, good: Any, found: Read) -> tuple[str, str]:
    """Name the outcome, and the problem if there is one."""
    if found.error:
        wrong = "\n" in found.error or len(found.error) > LINE_CHARS_MAX
        return "refused", f"a line of {len(found.error)} characters" if wrong else ""
    if found.value == good:
        return "the same", ""
    if found.told:
        return "told", ""
    return "another valid value", "another value, and nothing was told" if kind.checked else ""


def write(folder: Path, files: Files) -> None:
    """Write files below a folder."""
    for name, data in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)


def run_numbers(
    numbers: Sequence[int], seed: int, keep: Path | None = None, current: Synchronized[int] | None = None
) -> Outcome:
    """Read the inputs with these numbers; copy those with a problem to `keep`."""
    kinds = make_kinds()
    outcome = Outcome()
    with TemporaryDirectory(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None) as scratch:
        folder = Path(scratch) / "in"
        good = {}
        for name, kind in kinds.items():
            write(folder, kind.files)
            good[name] = read(kind, folder).value
            assert good[name] is not None, name
            shutil.rmtree(folder)
        for number in numbers:
            if current is not None:
                current.value = number
            draw = random.Random(f"{seed}:{number}")
            name = draw.choice(list(kinds))
            kind = kinds[name]
            changed, way = damaged(kind, draw)
            write(folder, kind.files | changed)
            # Junk behind a right checksum may give another value, which must be usable but need not be the same.
            judge = kind if way != "behind a right checksum" else Kind({}, (), kind.read)
            _one(outcome, (name, way), judge, good[name], folder, number)
            if keep is not None and outcome.problems and outcome.problems[-1].startswith(f"{number} "):
                shutil.copytree(folder, keep / str(number), dirs_exist_ok=True)
                write(keep / str(number), kind.files | changed)
            shutil.rmtree(folder)
    return outcome


def _one(outcome: Outcome, what: tuple[str, str], kind: Kind, good: Any, folder: Path, number: int) -> None:
    Path("/proc/self/clear_refs").write_text("5")  # reset the peak of resident memory
    began_s = time.monotonic()
    problem = ""
    try:
        came, problem = judged(kind, good, read(kind, folder))
    except Exception:  # noqa: BLE001
        came, problem = "crashed", traceback.format_exc(limit=-3)
    took_s, most_mb = time.monotonic() - began_s, highest_mb()
    if took_s > WAIT_MAX_S and took_s > stretched(WAIT_MAX_S):
        problem += f" took {took_s:.1f} s"
    if most_mb > MEMORY_MAX_MB:
        problem += f" took {most_mb:.0f} MB"
    outcome.done += 1
    outcome.counts[what[0], came] += 1
    outcome.longest_s, outcome.most_mb = max(outcome.longest_s, took_s), max(outcome.most_mb, most_mb)
    if problem:
        outcome.problems.append(f"{number} ({what[0]}, {what[1]}): {problem.strip()}")


def highest_mb() -> float:
    """Read this process's peak of resident memory (VmHWM) in MB."""
    line = next(one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


BLOCK = 500


def _block(first: int, count: int, seed: int, keep: Path | None, current: Synchronized[int], path: str) -> None:
    """Run in a separate process without stderr, on which libraries report damaged images, and with limited memory."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    done = run_numbers(range(first, first + count), seed, keep, current)
    counts = [[*key, value] for key, value in done.counts.items()]
    Path(path).write_text(json.dumps([counts, done.problems, done.longest_s, done.most_mb, done.done]))


def run_apart(first: int, count: int, seed: int, keep: Path | None) -> Outcome:
    """Run `run_numbers` in a separate process; if it ends or hangs, count a problem and continue after that number."""
    context = multiprocessing.get_context("fork")
    whole = Outcome()
    at = first
    with TemporaryDirectory() as folder:
        while at < first + count:
            path, current = str(Path(folder) / "out.json"), context.Value("q", at - 1)
            process = context.Process(target=_block, args=(at, first + count - at, seed, keep, current, path))
            process.start()
            began_s, seen = time.monotonic(), at - 1
            while process.is_alive():
                process.join(1.0)
                if current.value != seen:
                    seen, began_s = current.value, time.monotonic()
                elif time.monotonic() - began_s > _HANGS_S:
                    process.kill()
            if process.exitcode == 0:
                counts, problems, longest_s, most_mb, done = json.loads(Path(path).read_text())
                counted = Counter({(kind, came): value for kind, came, value in counts})
                whole.add(Outcome(counted, problems, longest_s, most_mb, done))
                return whole
            if seen < at:
                raise RuntimeError("no input was reached: run_numbers says why")
            # The earlier numbers went well, so they run again to be counted.
            whole.problems.append(f"{seen}: ended the process ({process.exitcode})")
            if seen > at:
                whole.add(run_apart(at, seen - at, seed, keep))
            whole.counts["", "crashed"] += 1
            whole.done += 1
            at = seen + 1
    return whole


def table(outcome: Outcome) -> str:
    """Write a table with a row for each kind."""
    ways = ("refused", "the same", "told", "another valid value", "crashed")
    rows = ["| input | fed | " + " | ".join(ways) + " |", "|---|" + "---:|" * (len(ways) + 1)]
    for kind in sorted({kind for kind, _ in outcome.counts}):
        counts = [outcome.counts[kind, way] for way in ways]
        rows.append(f"| {kind} | {sum(counts)} | {' | '.join(map(str, counts))} |")
    sums = [sum(n for (_, way), n in outcome.counts.items() if way == one) for one in ways]
    rows.append(f"| all | {outcome.done} | {' | '.join(map(str, sums))} |")
    rows.append(
        f"\nLongest {outcome.longest_s:.2f} s; the process at most {outcome.most_mb:.0f} MB, with its libraries."
    )
    return "\n".join(rows)
