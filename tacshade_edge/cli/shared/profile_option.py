"""The option ``--profile`` of commands whose results must not depend on the machine's speed."""

from __future__ import annotations

import argparse

from tacshade_edge.core.profiles import AUTO, DEFAULT, PROFILES


def add_profile(parser: argparse.ArgumentParser, default: str = DEFAULT) -> None:
    """Declare ``--profile``."""
    parser.add_argument(
        "--profile",
        type=_fixed,
        choices=sorted(PROFILES),
        default=default,
        help=f"profile, a trade-off between speed and accuracy (default: {default})",
    )


def _fixed(text: str) -> str:
    if text == AUTO:
        expected = ", ".join(sorted(PROFILES))
        raise argparse.ArgumentTypeError(
            f"found {AUTO}, which adapts to the clock, so no two runs would be the same; expected one of {expected}"
        )
    return text
