"""How long a test waits: its limits are for an idle machine of a known speed,
and stretch by how slow this one is now.

A limit here only ends a wait for something that will not come, so it may be far off; a promise in
seconds (`stretched`) may not. The speed is that of the interpreter, which is what most of a wait
is: of starting processes, imports, tests.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from functools import cache

UNIT_S = 0.0009
"""What `_unit` takes on an idle core of the machine that the limits were written on (this file,
run, prints it).
"""

LOOK_S = 0.25
MARGIN = 3.0


def _unit() -> int:
    """A few milliseconds of what tests do: calls, allocation, strings."""
    seen = {}
    for k in range(8000):
        seen[f"{k % 97}"] = k * k
    return sum(seen.values())


def slowness() -> float:
    """The factor on run times here and now against that machine,
    other processes and quotas included; at least 1.
    """
    began_s = time.perf_counter()
    units = 0
    while (took_s := time.perf_counter() - began_s) < LOOK_S:
        _unit()
        units += 1
    return max(1.0, took_s / units / UNIT_S)


@cache
def _first_slowness() -> float:
    return slowness()


def stretched(seconds: float) -> float:
    """A promised time in seconds, scaled to this machine as it is now."""
    return seconds * max(slowness(), _first_slowness())


def patience(seconds: float) -> float:
    """A limit in seconds that ends a test that hangs."""
    return MARGIN * seconds * _first_slowness()


def wait_until(
    condition: Callable[[], object],
    timeout_s: float = 10.0,
    what: str = "the condition holds",
    *,
    margin: float = MARGIN,
) -> None:
    """Poll until the condition holds; AssertionError
    when it does not within `margin` times the limit, stretched.

    A condition that takes long to look at, such as what a browser shows, is looked at a third of
    the time: what it waits for needs the cores too.
    """
    began_s = asked_s = time.monotonic()
    limit_s = timeout_s
    pause = threading.Event()
    while not condition():
        waited_s = time.monotonic() - began_s
        if waited_s >= limit_s:
            limit_s = margin * stretched(timeout_s)
            assert waited_s < limit_s, f"not within {waited_s:.1f} s: {what}"
        pause.wait(max(0.01, min(2 * (time.monotonic() - asked_s), 0.5)))
        asked_s = time.monotonic()


def promised(condition: Callable[[], object], seconds: float, what: str) -> None:
    """`wait_until` for a condition that is promised within `seconds`."""
    wait_until(condition, seconds, what, margin=1.0)


if __name__ == "__main__":
    looks = sorted(slowness() * UNIT_S for _ in range(9))
    print(
        f"a unit takes {1e3 * looks[4]:.2f} ms here ({1e3 * looks[0]:.2f} to {1e3 * looks[-1]:.2f})"
    )
