"""``tacshade-edge replay``: reconstructs a recording again, to files, to a broker, or both."""

from __future__ import annotations

import argparse
import contextlib
import math
import re
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from tacshade_edge.cli.shared.addresses import address
from tacshade_edge.cli.shared.profile_option import add_profile
from tacshade_edge.cli.shared.progress import Progress as Shown
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.replay import Deliver, Playback, Progress, ReplayLink, replay
from tacshade_edge.devices.mqtt.client import BrokerAddress
from tacshade_edge.factories import calibrations, links
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.settings import load
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.recording.recording_content import CALIBRATION_NAME, content_of
from tacshade_edge.storage.runs.run_compare import figures, first_difference
from tacshade_edge.storage.runs.run_files import RunWriter


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    add = parser.add_argument
    add("--calibration", type=Path, metavar="CAL.npz", help="calibration file (default: the recording's own)")
    add_profile(parser)
    add("--out", type=Path, metavar="DIR", help="folder for heights.bin, clouds.bin and summary.json")
    add(
        "--against",
        type=Path,
        metavar="DIR",
        help="compare the run in --out with this earlier run; exit with status 1 if they differ",
    )
    add(
        "--fps",
        type=positive,
        metavar="N",
        help="frame rate to assume for a recording without time stamps (default: 30)",
    )
    add(
        "--speed",
        type=positive,
        metavar="FACTOR",
        help="playback speed as a multiple of the recorded speed (default: as fast as possible)",
    )
    add(
        "--play",
        action="store_true",
        help="let the dashboard control playback (pause, step, seek) until you press Ctrl-C",
    )
    add(
        "--loop",
        type=_count,
        default=1,
        metavar="TIMES",
        help="number of times to play the recording; 0 repeats it until you press Ctrl-C (default: 1)",
    )
    add("--mqtt", type=address(), metavar="HOST:PORT", help="publish to this broker as `run` does")
    add("--config", type=Path, metavar="FILE", help="publish as `run` does, to the broker in these settings")
    add(
        "--sensor-id",
        type=_sensor_id,
        default="replay",
        metavar="ID",
        help="publish on topics under tacshade/ID (default ID: replay)",
    )
    add(
        "input",
        type=Path,
        nargs="?",
        metavar="INPUT",
        help="video file or folder of images; omit INPUT if you only want to compare two runs",
    )
    parser.set_defaults(refuse=parser.error)


def run(args: argparse.Namespace) -> int:
    """Replay a recording, compare two runs, or both; return 1 if the runs differ."""
    _check(args, args.refuse)
    code = 0
    if args.input is not None:
        code = _replay(args)
    if args.against is None:
        return code
    difference = first_difference(args.out, args.against)
    if difference:
        print(f"{args.out} differs from {args.against}: {difference}")
        for line in figures(args.out, args.against):
            print(f"  {line}")
        return 1
    print(f"{args.out} is the same as {args.against}")
    return code


def _check(args: argparse.Namespace, refuse: Callable[[str], None]) -> None:
    """Check the combinations of arguments that argparse cannot; `refuse` exits with 2."""
    if args.against is not None and args.out is None:
        refuse("--against: found no --out DIR to compare with, expected both")
    if args.input is None:
        if args.against is None:
            refuse("expected INPUT, or --out DIR and --against DIR to compare two runs")
        return
    if args.calibration is None and CALIBRATION_NAME not in content_of(args.input):
        refuse(f"expected --calibration CAL.npz: {args.input} has no {CALIBRATION_NAME} of its own")
    if args.mqtt is not None and args.config is not None:
        refuse("--mqtt and --config both name a broker, expected one of them")
    if args.out is None and args.mqtt is None and args.config is None:
        refuse("expected --out DIR, a broker (--mqtt HOST:PORT or --config FILE), or both")
    if args.play and (args.out is not None or (args.mqtt is None and args.config is None) or args.loop != 1):
        refuse("--play serves a dashboard, expected --mqtt HOST:PORT or --config FILE, and neither --out nor --loop")
    if args.loop == 0 and args.out is not None:
        refuse("--loop 0 never ends and would fill --out DIR, expected at least 1")
    if args.out is not None and args.against is not None and args.out.resolve() == args.against.resolve():
        refuse("--out and --against name the same folder, which the replay would overwrite")


def _replay(args: argparse.Namespace) -> int:
    broker = _broker(args)
    recording = Recording(args.input, fps=args.fps, times=args.loop)
    if recording.cut_off:
        _report(f"{args.input}: the recording was cut off; replaying what was written until then")
    if recording.damage:
        _report(recording.damage)
    given = args.calibration
    calibration = calibrations.of_recording(args.input) if given is None else calibrations.load(given)
    assert calibration is not None  # `_check` has checked it
    reconstructor = make_reconstructor(calibration, PROFILES[args.profile])
    for number in (signal.SIGTERM, signal.SIGINT):  # SIGINT too: a shell's background jobs start with it ignored
        signal.signal(number, signal.default_int_handler)
    progress, shown = Progress(), Shown()
    sinks: list[Deliver] = []
    interrupted = False
    with contextlib.ExitStack() as stack:
        if broker is not None:
            wait = args.speed is None and not args.play
            link = ReplayLink(broker=broker, sensor_id=args.sensor_id, reconstructor=reconstructor, wait=wait)
            stack.callback(link.stop)
            link.start()
            sinks.append(link.add)
            if args.play:
                player = Playback(lambda: Recording(args.input, fps=args.fps), args.speed or 1.0, link.report_playback)
                link.obey(player)
        if args.out is not None:
            writer = RunWriter(args.out, calibration_crc32=reconstructor.calibration.crc32)
            stack.callback(writer.discard)
            sinks.append(writer.add)
        # `progress` counts a frame after all sinks, so add one. With --play, the user may repeat frames: no total.
        total = None if args.play else recording.frames
        sinks.append(lambda *_: shown("frames", progress.frames + 1, total))
        try:
            played = player if args.play else recording
            speed = None if args.play else args.speed
            replay(
                played,
                reconstructor,
                sinks,
                progress,
                speed=speed,
                undecodable=lambda line: shown.say(f"tacshade-edge: {line}"),
            )
        except KeyboardInterrupt:
            interrupted = True
        shown.end()
        if args.out is not None and not interrupted:
            writer.finish(progress.as_dict())
    print(_line(args, progress))
    if broker is not None:
        counters = link.counters()
        print(
            ", ".join(f"{counters[name]} payloads {name}" for name in ("published", "superseded", "failed", "refused"))
        )
    if interrupted:
        if args.out is not None:
            _report(f"{args.out}: stopped before the end and wrote nothing")
        return 0 if args.loop == 0 or args.play else 130
    return 1 if progress.undecodable else 0


def _broker(args: argparse.Namespace) -> BrokerAddress | None:
    if args.config is not None:
        document = load(args.config)
        links.check_broker_files(document)
        return links.broker_address(document)
    if args.mqtt is None:
        return None
    host, port = args.mqtt
    return BrokerAddress(host=host, port=port, username=None, password=None, tls_ca=None)


def _line(args: argparse.Namespace, progress: Progress) -> str:
    return (
        f"{args.input}: {progress.frames} frames, {progress.contacts} in contact, {progress.invalid} invalid, "
        f"{progress.undecodable} unreadable; {progress.recorded_seconds:.2f} s of recording in "
        f"{progress.seconds:.2f} s, {progress.speed_up:.2f} times real time"
    )


def _report(line: str) -> None:
    print(f"tacshade-edge: {line}", file=sys.stderr)


def positive(text: str) -> float:
    """Return a number above 0 and at most a million, for argparse."""
    value = float(text)
    if not (math.isfinite(value) and 0 < value <= 1e6):
        raise argparse.ArgumentTypeError(f"found {text}, expected a number above 0 and at most a million")
    return value


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise argparse.ArgumentTypeError(f"found {text}, expected a whole number from 0")
    return int(text)


def _sensor_id(text: str) -> str:
    if not re.fullmatch(r"(?!hand$)[A-Za-z0-9_-]{1,64}", text):
        raise argparse.ArgumentTypeError(f"found {text}, expected letters, digits, - and _, but not the word hand")
    return text
