#!/usr/bin/env python3
"""The fault bench: faults in real parts, damaged inputs, arbitrary requests and lines, kills, and a long run.

::

    .venv/bin/python -m tools.faults table [--only NAME...]
    .venv/bin/python -m tools.faults damage [--count 100000] [--first 0] [--seed 0] [--keep DIR]
    .venv/bin/python -m tools.faults words [--requests 500000] [--lines 500000] [--through-broker 20000]
    .venv/bin/python -m tools.faults kills [--count 200] [--seed 0]
    .venv/bin/python -m tools.faults soak [--seconds 3600]
    .venv/bin/python -m tools.faults soak-hand [--seconds 7200]

Each command prints a table and any problems, and exits with 1 if there are problems. The seed and a number determine
each input, request, line or kill: ``--first N --count 1`` repeats number N. `reliability.md` lists the promises.
"""

from __future__ import annotations

import argparse
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from tools.faults import damage, hand_soak, kills, soak, table, words

CHUNK = 5000
CALIBRATIONS = 4
"""Number of daemon kills for each kill of `calibrate`."""


def faults(args: argparse.Namespace) -> tuple[str, list[str]]:
    """Faults in real parts; a line for each goes to stderr."""
    rows = list(table.run(args.only, lambda text: print(text, file=sys.stderr, flush=True)))
    return table.table([row for row, _ in rows]), [problem for _, problem in rows if problem]


def damaged(args: argparse.Namespace) -> tuple[str, list[str]]:
    """Damaged inputs; progress goes to stderr, so that an interrupted run can be continued."""
    out = damage.Outcome()
    last = args.first + args.count
    for first in range(args.first, last, CHUNK):
        part = damage.run_apart(first, min(CHUNK, last - first), args.seed, args.keep)
        out.add(part)
        print("\n".join((f"up to {first + CHUNK}", *part.problems)), file=sys.stderr, flush=True)
    return damage.table(out), out.problems


def said(args: argparse.Namespace) -> tuple[str, list[str]]:
    """Requests and lines."""
    came = words.run(args.requests, args.lines, args.through_broker, args.first, args.seed)
    return words.table(came), came.problems


def killed(args: argparse.Namespace) -> tuple[str, list[str]]:
    """Daemons, and a quarter as many calibrations."""
    out = kills.Kills()
    calibrations = args.count // CALIBRATIONS
    kills.run_daemons(args.count - calibrations, args.seed, out)
    kills.run_calibrations(calibrations, args.seed, out)
    return kills.table(out), out.problems


def soaked(args: argparse.Namespace) -> tuple[str, list[str]]:
    """A long run; a line a minute goes to stderr."""
    out = soak.run(args.seconds, progress=True)
    return soak.table(out), out.problems


def soaked_hand(args: argparse.Namespace) -> tuple[str, list[str]]:
    """A long run of a whole hand; a line a minute goes to stderr."""
    out = hand_soak.run(args.seconds, progress=True)
    return hand_soak.table(out), out.problems


def main() -> int:
    """Run one of the commands; return 1 if it found a problem."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name: str, run: Callable[[argparse.Namespace], tuple[str, list[str]]]) -> argparse.ArgumentParser:
        made = commands.add_parser(name, help=(run.__doc__ or "").splitlines()[0])
        made.set_defaults(run=run)
        return made

    one = command("table", faults)
    one.add_argument("--only", nargs="+", metavar="WORD", help="faults whose names have one of these")
    one = command("damage", damaged)
    one.add_argument("--count", type=int, default=100_000, metavar="N")
    one.add_argument("--first", type=int, default=0, metavar="N")
    one.add_argument("--seed", type=int, default=0, metavar="N")
    one.add_argument("--keep", type=Path, metavar="DIR", help="problems are kept there, below their number")
    one = command("words", said)
    one.add_argument("--requests", type=int, default=500_000, metavar="N", help="in process")
    one.add_argument("--lines", type=int, default=500_000, metavar="N", help="over a pty")
    one.add_argument("--through-broker", type=int, default=20_000, metavar="N")
    one.add_argument("--first", type=int, default=0, metavar="N")
    one.add_argument("--seed", type=int, default=0, metavar="N")
    one = command("kills", killed)
    one.add_argument("--count", type=int, default=200, metavar="N")
    one.add_argument("--seed", type=int, default=0, metavar="N")
    one = command("soak", soaked)
    one.add_argument("--seconds", type=float, default=3600.0)
    one = command("soak-hand", soaked_hand)
    one.add_argument("--seconds", type=float, default=7200.0)
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that brokers and daemons end, too
    text, problems = args.run(args)
    print(text)
    if problems:
        print("\n```\n" + "\n".join(problems) + "\n```")
        print("\n".join(problems), file=sys.stderr)  # so that problems are visible when the table is discarded
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
