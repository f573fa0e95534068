"""``tacshade-edge run``: the daemon."""

from __future__ import annotations

import argparse
import os
import signal
from pathlib import Path

from tacshade_edge.cli.check_config import DEFAULT_CONFIG
from tacshade_edge.cli.logs import add_verbosity, start_logging
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.supervisor import Supervisor
from tacshade_edge.devices import registry
from tacshade_edge.settings import load_all


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's options."""
    add_verbosity(parser)
    parser.add_argument(
        "--config", type=Path, default=DEFAULT_CONFIG, metavar="FILE", help="settings (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM, SIGINT, or the end of a finite source; SIGHUP reloads, unless a terminal hangs up.

    With several sensors in the file this goes on in a process for each.
    """
    start_logging(args.log_level)
    documents = load_all(args.config)
    document = documents[0]
    if document.several:
        mine = Supervisor(documents).run()
        if isinstance(mine, int):
            return mine
        start_logging(args.log_level, mine.settings.sensor_id)
        document = mine
    registry.check_files(document)
    calibration = registry.find_calibration(document, store=True)
    app = App(document, registry.make_source(document.settings.source), calibration)
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: app.stop())
    if not os.isatty(0):
        signal.signal(signal.SIGHUP, lambda *_: app.reload())
    app.run()
    return 0
