"""A pytest plugin that lists each test's processor time, with the processes that it started and ended.

::

    .venv/bin/python -m pytest -p tools.ci.processor_times -m slow tests/core

`--durations` lists what waits, and on a shared machine says little of what `make test` has to fit into.
"""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

MOST = 40
_took_s: dict[str, float] = {}


def _processors_s() -> float:
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Count a fixture for the first test that uses it."""
    began_s = _processors_s()
    result = yield
    _took_s[item.nodeid] = _processors_s() - began_s
    return result


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the sum and the greatest times."""
    terminalreporter.section(f"processor time: {sum(_took_s.values()):.0f} s")
    for nodeid in sorted(_took_s, key=lambda nodeid: -_took_s[nodeid])[:MOST]:
        terminalreporter.write_line(f"{_took_s[nodeid]:7.2f} s  {nodeid}")
