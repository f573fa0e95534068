"""``tacshade-edge evaluate`` on every family, and on the sensors kept for the figures of a release.

.venv/bin/python -m tools.studies.evaluate [--sensors default,other:31 | --final] [what else
`evaluate` takes]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from tacshade_edge.cli.commands import evaluate
from tacshade_edge.errors import TacshadeError
from tools.testbed.simulator.families import FINAL_SEED, FINAL_SENSORS


def main(words: Sequence[str] | None = None) -> int:
    """Evaluate; return 1 on a user's mistake."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.set_defaults(parser=parser)
    evaluate.add_arguments(parser)
    kept = f"sensors from seed {FINAL_SEED} on: not to be looked at while working"
    parser.add_argument("--final", action="store_true", help=kept)
    args = parser.parse_args(words)
    named = args.sensors or ()
    if any(name.seed is not None and name.seed >= FINAL_SEED for name in named):
        parser.error(f"--sensors: seeds from {FINAL_SEED} on are kept for --final")
    if args.final:
        if named:
            parser.error("--final does not go with --sensors")
        args.sensors = FINAL_SENSORS
    try:
        return evaluate.run(args)
    except TacshadeError as error:
        parser.exit(1, f"{parser.prog}: {error}\n")


if __name__ == "__main__":
    sys.exit(main())
