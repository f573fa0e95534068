"""``tacshade-edge demo``: the simulated sensor through the daemon's own threads, shown in the terminal."""

from __future__ import annotations

import argparse
import math
import signal
import sys
import time
from queue import Empty, SimpleQueue

from tacshade_edge.cli.demo_sensor import make_calibration
from tacshade_edge.cli.demo_view import MAP_ROWS, character_map, status_line
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.daemon.health import delivered
from tacshade_edge.daemon.ledger import FrameLedger, Outcome
from tacshade_edge.daemon.pipeline import Crash, Pipeline, crashes_to
from tacshade_edge.daemon.workers import SourceState
from tacshade_edge.devices.simulated import SimulatedSource
from tacshade_edge.types import Calibration, Frame, Reconstruction

FPS = 20.0  # a laptop draws a frame in 10 to 40 ms
TERMINAL_PERIOD_S, PIPE_PERIOD_S = 0.1, 0.5
STOP_S = 1.5


class Latest:
    """A `Sink` that keeps the newest result for the terminal."""

    def __init__(self) -> None:
        self.result: Reconstruction | None = None

    def deliver(self, frame: Frame, result: Reconstruction, calibration: Calibration) -> Outcome | None:
        """Keep it."""
        self.result = result
        if not result.valid:
            return "invalid"
        return "published" if result.contact else "without_contact"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    parser.add_argument("--seconds", type=float, default=math.inf, metavar="N", help="end by itself after N seconds")


def run(args: argparse.Namespace) -> int:
    """Show the simulated hand until Ctrl-C, SIGTERM or ``--seconds``."""
    events: SimpleQueue[Crash | SourceState | int] = SimpleQueue()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda received, _: events.put(received))
    live = sys.stdout.isatty()
    print("Calibrating a simulated sensor on simulated ball presses ...", flush=True)
    calibration = make_calibration()
    if live:
        print("A simulated hand presses one object after another. Ctrl-C ends.", flush=True)
    source, sink, ledger = SimulatedSource(fps=FPS), Latest(), FrameLedger()
    with crashes_to(events.put):
        pipeline = Pipeline(source, Reconstructor(calibration, PROFILES["fast"]), sink, ledger, events.put)
        pipeline.start()
        crash = _show(events, source, sink, ledger, live, time.monotonic() + args.seconds)
        pipeline.stop(STOP_S)
    if crash is not None:
        raise crash.error
    counts = ledger.counts()
    print(f"{counts.captured} frames, {counts.published} with contact, {counts.superseded} superseded")
    return 0


def _show(
    events: SimpleQueue[Crash | SourceState | int],
    source: SimulatedSource,
    sink: Latest,
    ledger: FrameLedger,
    live: bool,
    deadline_s: float,
) -> Crash | None:
    """Print the newest result again and again; the crash that ended it, or None."""
    period_s = TERMINAL_PERIOD_S if live else PIPE_PERIOD_S
    before, before_s, fps, shown = ledger.counts(), time.monotonic(), 0.0, -1
    drawn = False
    while (now_s := time.monotonic()) < deadline_s:
        if now_s - before_s >= 1.0:
            counts = ledger.counts()
            fps = (delivered(counts) - delivered(before)) / (now_s - before_s)
            before, before_s = counts, now_s
        result = sink.result
        if result is not None and result.seq != shown:
            shown = result.seq
            pressed_mm = max((press.depth_mm for press in source.presses(result.seq)), default=0.0)
            line = status_line(result, pressed_mm, fps)
            if live:
                _redraw([*character_map(result.height), line], drawn)
                drawn = True
            else:
                print(line, flush=True)
        try:
            event = events.get(timeout=min(period_s, max(0.0, deadline_s - time.monotonic())))
        except Empty:
            continue
        if isinstance(event, Crash):
            return event
        if isinstance(event, int):
            break
    return None


def _redraw(lines: list[str], again: bool) -> None:
    """Print the block, over the one before."""
    up = f"\x1b[{MAP_ROWS + 1}A" if again else ""
    sys.stdout.write(up + "".join(f"{line}\x1b[K\n" for line in lines))
    sys.stdout.flush()
