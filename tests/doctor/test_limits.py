from __future__ import annotations

import threading
import time

from tacshade_edge.doctor.limits import start, wait_for
from tools.testbed.patience import patience


def test_a_result() -> None:
    assert wait_for(start(lambda: 5), time.monotonic() + 10, lambda why: -1) == 5


def test_a_job_that_hangs_is_left_behind() -> None:
    release = threading.Event()
    began_s = time.monotonic()
    hung = start(lambda: str(release.wait(60)))
    quick = start(lambda: "quick")
    deadline_s = began_s + 0.05
    assert wait_for(hung, deadline_s, lambda why: why) == "no answer in time"
    assert wait_for(quick, deadline_s, lambda why: why) == "quick", "though the limit has passed"
    assert time.monotonic() - began_s < patience(10)
    release.set()


def test_a_job_that_breaks_is_failure() -> None:
    broken = start(lambda: str(1 // 0))
    failure = wait_for(broken, time.monotonic() + 10, lambda why: why)
    assert failure == "the check itself failed: ZeroDivisionError: integer division or modulo by zero"
