"""``tacshade-edge run``: runs the daemon."""

from __future__ import annotations

import argparse
import gc
import logging
import os
import signal
from collections.abc import Sequence
from typing import TYPE_CHECKING

from tacshade_edge.calibration import loading
from tacshade_edge.camera.sources import make_source
from tacshade_edge.cli import EXIT_OK
from tacshade_edge.cli.shared.finger_places import finger_doubt
from tacshade_edge.cli.shared.logs import add_verbosity, start_logging
from tacshade_edge.cli.shared.options import add_config
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.named_files import check_files
from tacshade_edge.daemon.supervisor import EXIT_STOPPED, Supervisor, name_of
from tacshade_edge.settings import Document, Hand, load_all, load_hand
from tacshade_edge.types import Calibration

if TYPE_CHECKING:
    from tacshade_edge.daemon.hand_process import FingerLine
    from tacshade_edge.robot.robot import SharedLine

_log = logging.getLogger(__name__)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_verbosity(parser)
    add_config(parser)


def run(args: argparse.Namespace) -> int:
    """Run until SIGTERM, SIGINT, or a finite source's end; SIGHUP reloads.

    Several sensors have a process each.
    """
    start_logging(args.log_level)
    documents = load_all(args.config)
    if not documents[0].several:
        start_logging(args.log_level, documents[0].settings.sensor_id, each_line=False)
        # The collector would search all modules, for 15 ms, while a frame waits.
        gc.freeze()
        return _run_sensor(documents[0])
    # Only a hand or several sensors need it.
    from tacshade_edge.daemon import hand_process

    hand = load_hand(args.config)
    # Lines between processes have to be there before the supervisor forks.
    lines = hand_process.Lines(hand.fingers if hand else ())
    shared_lines: dict[str, SharedLine] = {}
    if any(document.settings.serial for document in documents):
        from tacshade_edge.robot.robot import share_lines

        shared_lines = share_lines(documents)

    def work(part: Document | Hand) -> int:
        start_logging(args.log_level, name_of(part))
        if isinstance(part, Hand):
            hand_process.run(part, lines)
            return EXIT_STOPPED
        name = part.settings.sensor_id
        fingers = documents if hand else ()
        return _run_sensor(part, lines.fingers.get(name), shared_lines.get(name), fingers)

    return Supervisor(documents, hand, lines.end).run(work)


def _run_sensor(
    document: Document,
    hand_line: FingerLine | None = None,
    robot_line: SharedLine | None = None,
    fingers: Sequence[Document] = (),
) -> int:
    check_files(document)
    # A calibration of an older version is made anew and stored, so that it takes this time once.
    calibration = loading.find_calibration(document, store=True)
    if isinstance(calibration, Calibration):
        # By this sensor's size alone: the others' calibrations would take their time and memory.
        known = {document.settings.sensor_id: calibration}
        if doubt := finger_doubt(fingers, known):
            _log.warning("%s: %s", *doubt)
    source = make_source(document.settings.source, loading.size_px(calibration))
    app = App(document, source, calibration, hand_line, robot_line)
    stopped: list[int] = []

    def stop(number: int, _: object) -> None:
        stopped.append(number)
        app.stop()

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, stop)
    # At a terminal, SIGHUP says that it was closed, and ends the daemon.
    if not os.isatty(0):
        signal.signal(signal.SIGHUP, lambda *_: app.reload())
    app.run()
    # A sensor that was not meant to end is started again; 0 says that its source has ended.
    return EXIT_STOPPED if stopped and document.several else EXIT_OK
