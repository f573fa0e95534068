"""``tacshade-edge record``: the camera of the settings into a folder that `replay` reads."""

from __future__ import annotations

import argparse
import signal
import sys
import threading
from pathlib import Path

from tacshade_edge.cli.check_config import DEFAULT_CONFIG
from tacshade_edge.cli.replay import positive
from tacshade_edge.daemon.record import record
from tacshade_edge.daemon.workers import SourceState
from tacshade_edge.devices import registry
from tacshade_edge.devices.recorder import FREE_FLOOR_BYTES, Recorder
from tacshade_edge.settings import load


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help="settings (default: %(default)s)")
    add("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    add("--seconds", type=positive, required=True, metavar="N", help="how long; Ctrl-C ends it earlier")


def run(args: argparse.Namespace) -> int:
    """Record; 1 when the disk ended it or no frame came."""
    document = load(args.config)
    registry.check_files(document)
    registry.load_calibration(document)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    recorder = Recorder(args.out, free_floor_bytes=FREE_FLOOR_BYTES)
    recorder.copy(args.config, "settings.yaml")
    recorder.copy(Path(document.settings.calibration), "calibration.npz")
    source = registry.make_source(document.settings.source)
    ending = record(source, recorder, seconds=args.seconds, stopped=stop.is_set, told=_tell)
    print(f"{args.out}: {recorder.frames} frames ({ending})")
    if ending == "disk":
        line = (
            f"{args.out}: stopped with less than {FREE_FLOOR_BYTES // 2**20} MiB free on the disk; what is there stays"
        )
        print(f"tacshade-edge: {line}", file=sys.stderr)
    return 0 if recorder.frames and ending != "disk" else 1


def _tell(state: SourceState) -> None:
    if state.reason:
        print(f"tacshade-edge: source {state.state}: {state.reason}", file=sys.stderr)
