"""``tacshade-edge export``: reconstructs a recording and writes it in other tools' formats."""

from __future__ import annotations

import argparse
from contextlib import AbstractContextManager
from pathlib import Path

from tacshade_edge.calibration import loading
from tacshade_edge.cli.shared.options import add_option, add_profile, warn
from tacshade_edge.daemon.playback import PlaybackProgress, replay
from tacshade_edge.errors import ConfigError
from tacshade_edge.quoting import counted
from tacshade_edge.recording.exports.table_export import (
    Add,
    check_new,
    csv_export,
    ply_export,
    write_hand_csv,
)
from tacshade_edge.recording.mcap import is_mcap, require_mcap
from tacshade_edge.recording.recording import Recording
from tacshade_edge.recording.recording_content import CALIBRATION_NAME, content_of
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.touch.touch_answer import PLAIN
from tacshade_edge.types import Calibration

SENSOR_ID = "replay"
SUFFIXES = {"mcap": ".mcap", "csv": ".csv", "ply": "-ply"}
"""For each format, what follows the recording's name if --out is missing."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    text = "output format; mcap needs the extra of the same name"
    parser.add_argument("--to", choices=tuple(SUFFIXES), required=True, help=text)
    add_option(
        parser, "--calibration", "CAL.npz", "calibration file (default: the recording's own)"
    )
    add_profile(parser)
    text = "file to create (for ply: folder to create; default: next to the recording)"
    add_option(parser, "--out", "PATH", text)
    add_option(parser, "--topic", "NAME", "image topic of an MCAP file that has several", str)
    text = (
        "recording that `replay` can read; to export a hand (csv or mcap), "
        "give one recording per finger"
    )
    add_option(parser, "input", "RECORDING", text, nargs="+")


def run(args: argparse.Namespace) -> int:
    """Export; return 1 if images could not be read, or a damaged table has lost some."""
    if len(args.input) > 1:
        return _export_hand(args)
    (path,) = args.input
    recording = Recording(path, topic=args.topic)
    for line in (
        recording.damage,
        "the recording was cut off; exporting what is whole" if recording.cut_off else "",
    ):
        if line:
            warn(f"{path}: {line}")
    content = content_of(path)
    if args.to == "mcap":
        require_mcap()
    out = args.out or _beside(path, args.to)
    check_new(out)
    calibration = _calibration(path, args.calibration)
    reconstructor = make_reconstructor(calibration, PROFILES[args.profile])
    progress = PlaybackProgress()
    with _export(args.to, out, calibration, args.profile, content) as add:
        replay(recording, reconstructor, [add], progress, speed=None, undecodable=warn)
    left_out = f", {progress.undecodable} unreadable" if progress.undecodable else ""
    frames = counted(progress.frames, "frame")
    print(f"{out}: {frames}, {progress.answers}, {progress.invalid} invalid{left_out}")
    return 1 if progress.undecodable or recording.lost else 0


def _export_hand(args: argparse.Namespace) -> int:
    """Export what the recorded fingers' hand would have published;
    log unreadable images and then return 1.
    """
    # A hand has no depth of its own, and so no points for PLY.
    if args.to not in ("csv", "mcap"):
        raise ConfigError(
            f"--to: found {args.to} for {len(args.input)} recordings, expected csv or mcap"
        )
    if args.calibration is not None:
        expected = "expected none; each recording contains its own"
        raise ConfigError(f"--calibration: found a calibration for several recordings, {expected}")
    if args.out is None:
        raise ConfigError(
            "--out: found no file name, expected the name of a new file to export several "
            "recordings to"
        )
    from tacshade_edge.hand.hand_recordings import read_hand

    check_new(args.out)
    if args.to == "mcap":
        require_mcap()
        from tacshade_edge.recording.exports.mcap_export import write_hand_mcap

        hand = read_hand(args.input, args.profile)
        count = write_hand_mcap(args.out, hand.hand_id, hand.messages)
    else:
        hand = read_hand(args.input, args.profile)
        count = write_hand_csv(args.out, hand.fingers, hand.messages)
    left_out = f", {counted(len(hand.unread), 'image')} unreadable" if hand.unread else ""
    print(
        f"{args.out}: {counted(count, 'message')} of "
        f"{counted(len(hand.fingers), 'finger')}{left_out}"
    )
    return 1 if hand.unread else 0


def _export(
    to: str, out: Path, calibration: Calibration, profile: str, content: dict[str, bytes]
) -> AbstractContextManager[Add]:
    """The export; MCAP's is imported on demand, because it needs extra packages."""
    if to == "csv":
        # The quantities of a touch: those learned from labels, or those known without labels.
        return csv_export(
            out, calibration.touch[profile].names if profile in calibration.touch else PLAIN
        )
    if to == "ply":
        return ply_export(out)
    from tacshade_edge.hand.hand_recordings import recorded_settings
    from tacshade_edge.recording.exports.mcap_export import mcap_export

    try:
        settings = recorded_settings(content)
    # Settings of another version of this program: they only give a name.
    except ConfigError:
        settings = None
    sensor_id = SENSOR_ID if settings is None else settings.sensor_id
    return mcap_export(
        out, sensor_id=sensor_id, calibration=calibration, profile=profile, content=content
    )


def _beside(recording: Path, to: str) -> Path:
    # The folder may be given as `.`, which has no name.
    recording = recording.resolve()
    name = (
        # A recording that was cut off still has the name of an incomplete file.
        recording.name.removesuffix(".part").removesuffix(".mcap")
        if is_mcap(recording)
        else recording.name
    )
    return recording.with_name(name + SUFFIXES[to])


def _calibration(recording: Path, given: Path | None) -> Calibration:
    """Return the given calibration, or else the recording's own.

    Raises ConfigError if there is neither.
    """
    own = loading.of_recording(recording) if given is None else loading.load(given)
    if own is None:
        raise ConfigError(
            f"{recording}: contains no {CALIBRATION_NAME}; pass --calibration CAL.npz"
        )
    return own
