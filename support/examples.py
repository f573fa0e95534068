"""On how many examples a property is tried."""

from __future__ import annotations

import os

from hypothesis import settings

AT_DESK, IN_CI = 100, 30
"""Where CI is set, as `make check` does, the examples are the same in every run and judge a change;
the desk looks for news with more.
"""


def at_most(desk: int) -> int:
    """So many at the desk, as many or `IN_CI` where CI is set."""
    return min(desk, IN_CI) if "CI" in os.environ else desk


def examples(desk: int) -> settings:
    """For a property that wants other than `AT_DESK`."""
    return settings(max_examples=at_most(desk))
