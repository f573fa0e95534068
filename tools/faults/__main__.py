#!/usr/bin/env python3
"""The fault bench: faults in real parts, the test suite's trials, kills at random moments and at
every phase of a start and a stop, and a long run.

::

    .venv/bin/python -m tools.faults table [--only WORD...]
    .venv/bin/python -m tools.faults trials [--only WORD...]
    .venv/bin/python -m tools.faults kills [--count 200] [--seed 0]
    .venv/bin/python -m tools.faults ends [--only WORD...]
    .venv/bin/python -m tools.faults soak [--seconds 3600]

Each command prints a table and any problems, and exits with 1 if there are problems.
`reliability.md` lists the promises.
"""

from __future__ import annotations

import argparse
import signal
import sys

from tools.faults import ends, kills, soak, table, trials


def main() -> int:
    """Run one of the commands; return 1 if it found a problem."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    one = commands.add_parser("table", help="each fault once, in real parts")
    one.add_argument(
        "--only", nargs="+", metavar="WORD", help="faults whose names have one of these"
    )
    one = commands.add_parser("trials", help="the test suite's trials, counted")
    one.add_argument(
        "--only", nargs="+", metavar="WORD", help="trials whose names have one of these"
    )
    one = commands.add_parser("kills", help="kill -9 at random moments")
    one.add_argument("--count", type=int, default=200, metavar="N")
    one.add_argument("--seed", type=int, default=0, metavar="N")
    one = commands.add_parser("ends", help="signals at every phase of a start and a stop")
    one.add_argument("--only", nargs="+", metavar="WORD", help="phases whose names have one")
    one = commands.add_parser("soak", help="a long run in which something is always wrong")
    one.add_argument("--seconds", type=float, default=3600.0)
    args = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that brokers and daemons end, too
    if args.command == "table":
        rows = list(table.run(args.only, lambda text: print(text, file=sys.stderr, flush=True)))
        text, problems = (
            table.table([row for row, _ in rows]),
            [problem for _, problem in rows if problem],
        )
    elif args.command == "trials":
        text, problems = trials.run(args.only)
    elif args.command == "kills":
        text, problems = kills.run(args.count, args.seed)
    elif args.command == "ends":
        text, problems = ends.run(list(ends.chosen(args.only)))
    else:
        text, problems = soak.run(args.seconds)
    print(text)
    if problems:
        print("\n```\n" + "\n".join(problems) + "\n```")
        print(
            "\n".join(problems), file=sys.stderr
        )  # so that problems are visible when the table is discarded
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
