from __future__ import annotations

import threading
import time
from types import SimpleNamespace
from typing import Any

import pytest

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.ledger import FrameLedger, Timings
from tacshade_edge.daemon.observer import FrameObserver, FrameResult, SourceState
from tacshade_edge.daemon.pipeline import Crash, Pipeline, crashes_to
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.types import Calibration, Need
from tools.testbed.patience import stretched


class Published(FrameObserver):
    def __init__(self, ledger: FrameLedger) -> None:
        self._ledger = ledger

    def need(self) -> Need:
        return Need.DEPTH

    def see(self, seen: FrameResult) -> None:
        self._ledger.settle(seen.frame.seq, "published")


def pipeline(
    source: Any, calibration: Calibration, told: list[SourceState], make: type[FrameObserver] = Published
) -> Pipeline:
    running, ledger = SimpleNamespace(reconstructor=make_reconstructor(calibration, PROFILES["fast"])), FrameLedger()
    return Pipeline(source, running, [make(ledger)], ledger, Timings(), told.append)  # type: ignore[call-arg]


def test_a_stop_finishes_the_frame_that_waits(
    calibration: Calibration, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    told: list[SourceState] = []
    line = pipeline(scripted([pictures.free] * 50 + [None]), calibration, told)
    line.start()
    wait_until(lambda: told[-1:] == [SourceState("ended")])
    assert line.stop(10)
    counts = line.ledger.counts()
    assert counts.pending == 0
    assert counts.captured == counts.published + counts.superseded == 50
    assert counts.published >= 1


def test_a_stop_leaves_a_hanging_read_behind(
    calibration: Calibration, pictures: Any, scripted: Any, wait_until: Any
) -> None:
    release = threading.Event()
    line = pipeline(scripted([pictures.free, release.wait, None]), calibration, [])
    line.start()
    wait_until(lambda: line.ledger.counts().published == 1)
    began = time.monotonic()
    assert not line.stop(0.2)
    assert time.monotonic() - began < stretched(2)  # the promise to systemd, not a speed
    release.set()


def test_an_exception_in_any_thread_is_reported_with_the_threads_name(
    calibration: Calibration, scripted: Any, wait_until: Any
) -> None:
    crashes: list[Crash] = []
    before = threading.excepthook
    with crashes_to(crashes.append):
        line = pipeline(scripted(ConfigError("x: found nothing")), calibration, [])
        line.start()
        wait_until(lambda: crashes != [])
        line.stop(10)
    assert [(c.thread, str(c.error)) for c in crashes] == [("grab", "x: found nothing")]
    assert threading.excepthook is before


def test_a_defect_in_a_step_is_reported(calibration: Calibration, scripted: Any, wait_until: Any) -> None:
    crashes: list[Crash] = []

    class Broken(Published):
        def see(self, seen: FrameResult) -> None:
            raise ZeroDivisionError("a defect")

    with crashes_to(crashes.append):
        line = pipeline(scripted([calibration.reference_grey, None]), calibration, [], Broken)
        line.start()
        wait_until(lambda: crashes != [])
        line.stop(10)
    assert crashes[0].thread == "reconstruct"
    with pytest.raises(ZeroDivisionError, match="a defect"):
        raise crashes[0].error
