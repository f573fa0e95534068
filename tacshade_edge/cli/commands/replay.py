"""``tacshade-edge replay``: reconstructs a recording again, to files, to a broker, or both."""

from __future__ import annotations

import argparse
import contextlib
import signal

from tacshade_edge.calibration import loading
from tacshade_edge.cli import EXIT_FAILED, EXIT_INTERRUPTED, EXIT_OK
from tacshade_edge.cli.shared.options import (
    COUNT,
    POSITIVE,
    RATE,
    add_flag,
    add_option,
    add_profile,
    address,
    sensor_id,
    warn,
)
from tacshade_edge.cli.shared.progress import Progress as Shown
from tacshade_edge.daemon.playback import Deliver, Playback, PlaybackProgress, ReplayLink, replay
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.targets import check_folder, owned_folder
from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.quoting import counted, shown
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.recording_content import CALIBRATION_NAME, content_of
from tacshade_edge.recording.runs import (
    CLOUDS,
    HEIGHTS,
    SHEARS,
    SUMMARY,
    TIMINGS,
    RunWriter,
    figures,
    first_difference,
    read_summary,
)
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.settings import load


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(
        parser, "--calibration", "CAL.npz", "calibration file (default: the recording's own)"
    )
    add_profile(parser)
    add_option(parser, "--out", "DIR", "folder for heights.bin, clouds.bin and summary.json")
    add_option(
        parser, "--against", "DIR", "compare the run in --out with this one; exit 1 if they differ"
    )
    add_option(
        parser,
        "--fps",
        "N",
        "frame rate of images or a video (default: the video's own times; 30 for images)",
        RATE,
    )
    add_option(parser, "--topic", "NAME", "image topic of an MCAP file that has several", str)
    add_option(
        parser,
        "--speed",
        "FACTOR",
        "multiple of the recorded speed (default: as fast as possible)",
        POSITIVE,
    )
    add_flag(parser, "--play", "let the dashboard pause, step and seek, until Ctrl-C")
    add_option(
        parser,
        "--loop",
        "TIMES",
        "times to play it; 0: until Ctrl-C (default: 1)",
        COUNT,
        default=1,
    )
    add_option(parser, "--mqtt", "HOST:PORT", "publish to this broker as `run` does", address())
    add_option(parser, "--config", "FILE", "publish as `run` does, to the broker in these settings")
    add_option(
        parser,
        "--sensor-id",
        "ID",
        "publish under tacshade/ID (default: replay)",
        sensor_id,
        default="replay",
    )
    add_option(
        parser,
        "input",
        "INPUT",
        "video or folder of images; not needed to compare two runs",
        nargs="?",
    )


def run(args: argparse.Namespace) -> int:
    """Replay a recording, compare two runs, or both; return 1 if the runs differ."""
    if mistake := _mistake(args):
        args.parser.error(mistake)
    code = EXIT_OK if args.input is None else _replay(args)
    if args.against is None:
        return code
    if difference := first_difference(args.out, args.against):
        print(f"{args.out} differs from {args.against}: {difference}")
        for line in figures(args.out, args.against):
            print(f"  {line}")
        return EXIT_FAILED
    print(f"{args.out} is the same as {args.against}")
    return code


def _mistake(args: argparse.Namespace) -> str:
    """Return what is wrong with a combination of arguments that argparse cannot check."""
    out, against, has_broker = (
        args.out,
        args.against,
        args.mqtt is not None or args.config is not None,
    )
    if against is not None and out is None:
        return "--against: found no --out DIR to compare with, expected both"
    if args.input is None:
        return (
            ""
            if against is not None
            else "expected INPUT, or --out DIR and --against DIR to compare two runs"
        )
    # Opened for its calibration below, a missing recording would only seem to lack one.
    if args.calibration is None and not args.input.exists():
        raise ConfigError(f"{shown(args.input)}: found nothing, expected a recording")
    if args.calibration is None and CALIBRATION_NAME not in content_of(args.input):
        return f"expected --calibration CAL.npz: {args.input} has no {CALIBRATION_NAME} of its own"
    if args.mqtt is not None and args.config is not None:
        return "--mqtt and --config both name a broker, expected one of them"
    if out is None and not has_broker:
        return "expected --out DIR, a broker (--mqtt HOST:PORT or --config FILE), or both"
    if args.play and (out is not None or not has_broker or args.loop != 1):
        return (
            "--play serves a dashboard, expected --mqtt HOST:PORT or --config FILE, and neither "
            "--out nor --loop"
        )
    if args.loop == 0 and out is not None:
        return "--loop 0 never ends and would fill --out DIR, expected at least 1"
    # Resolved, because the same folder has many names.
    if out is not None and against is not None and out.resolve() == against.resolve():
        return "--out and --against name the same folder, which the replay would overwrite"
    return ""


def _replay(args: argparse.Namespace) -> int:
    with contextlib.nullcontext() if args.out is None else owned_folder(args.out, "replay"):
        return _replayed(args)


def _replayed(args: argparse.Namespace) -> int:
    broker = _broker(args)
    recording = _opened(args)
    given = args.calibration
    calibration = loading.of_recording(args.input) if given is None else loading.load(given)
    # `_mistake` has checked it.
    assert calibration is not None
    _check_runs(args)
    reconstructor = make_reconstructor(calibration, PROFILES[args.profile])
    # SIGINT too: a shell's background jobs start with it ignored.
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, signal.default_int_handler)
    progress, shown, is_interrupted = PlaybackProgress(), Shown(), False
    sinks: list[Deliver] = []
    played: Recording | Playback = recording
    link = writer = None
    with contextlib.ExitStack() as stack:
        if broker is not None:
            link = _started_link(args, broker, reconstructor, stack)
            sinks.append(link.add)
            if args.play:
                played = link.playback = _playback(args, link)
        if args.out is not None:
            writer = RunWriter(args.out, calibration_crc32=reconstructor.calibration.crc32)
            # Without `finish`, as after an error, nothing of the run stays: half a run would
            # compare as one that differs.
            stack.callback(writer.discard)
            sinks.append(writer.add)
        # `progress` counts a frame after all sinks, so add one.
        # With --play, the user may repeat frames: no total.
        total, speed = (None, None) if args.play else (recording.frames, args.speed)
        sinks.append(lambda *_: shown("frames", progress.frames + 1, total))
        try:
            replay(played, reconstructor, sinks, progress, speed=speed, undecodable=shown.warn)
        except KeyboardInterrupt:
            is_interrupted = True
        shown.end()
        if writer is not None and not is_interrupted:
            writer.finish(progress.as_dict())
    _print_counts(args, progress, link)
    if is_interrupted:
        if writer is not None:
            warn(f"{args.out}: stopped before the end and wrote nothing")
        # What never ends by itself is not cut short by Ctrl-C.
        return EXIT_OK if args.loop == 0 or args.play else EXIT_INTERRUPTED
    return EXIT_FAILED if progress.undecodable or recording.lost else EXIT_OK


def _check_runs(args: argparse.Namespace) -> None:
    """Refuse a run to compare with that is none, and a folder for a run that cannot be written;
    either would cost a whole replay. Raises ConfigError, DecodeError and DeviceError.
    """
    if args.against is not None:
        read_summary(args.against)
    if args.out is not None:
        check_folder(args.out, (HEIGHTS, CLOUDS, SHEARS, SUMMARY, TIMINGS))


def _opened(args: argparse.Namespace) -> Recording:
    recording = Recording(args.input, fps=args.fps, times=args.loop, topic=args.topic)
    if recording.cut_off:
        warn(f"{args.input}: the recording was cut off; replaying what was written until then")
    if recording.damage:
        warn(recording.damage)
    return recording


def _started_link(
    args: argparse.Namespace,
    broker: BrokerAddress,
    reconstructor: Reconstructor,
    stack: contextlib.ExitStack,
) -> ReplayLink:
    # At no speed of its own, a replay waits until the broker has each frame, and drops none.
    wait = args.speed is None and not args.play
    link = ReplayLink(
        broker=broker, sensor_id=args.sensor_id, reconstructor=reconstructor, wait=wait
    )
    stack.callback(link.stop)
    link.start()
    return link


def _playback(args: argparse.Namespace, link: ReplayLink) -> Playback:
    return Playback(
        # A person watches: at the recorded pace, and not as fast as possible.
        lambda: Recording(args.input, fps=args.fps, topic=args.topic),
        args.speed or 1.0,
        link.report_playback,
    )


def _print_counts(
    args: argparse.Namespace, progress: PlaybackProgress, link: ReplayLink | None
) -> None:
    print(
        f"{args.input}: {counted(progress.frames, 'frame')}, {progress.answers}, "
        f"{progress.invalid} invalid, {progress.undecodable} unreadable; "
        f"{progress.recorded_seconds:.2f} s of recording in {progress.seconds:.2f} s, "
        f"{progress.speed_up:.2f} times real time"
    )
    if link is not None:
        counts = link.counters()
        names = ("published", "superseded", "failed", "refused")
        print(", ".join(f"{counts[name]} payloads {name}" for name in names))


def _broker(args: argparse.Namespace) -> BrokerAddress | None:
    if args.config is not None:
        document = load(args.config)
        links.check_broker_files(document)
        return links.broker_address(document)
    if args.mqtt is None:
        return None
    host, port = args.mqtt
    return BrokerAddress(host=host, port=port, username=None, password=None, tls_ca=None)
