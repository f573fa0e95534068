"""``tacshade-edge stitch``: combines images and poses into one map,
or finds the sensor's pose on the flange.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.cli import EXIT_FAILED, EXIT_OK
from tacshade_edge.cli.shared.options import add_flag, add_option, add_profile, warn
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.targets import check_folder, owned_folder
from tacshade_edge.lab.studies.stitch.map_presses import (
    PRESSES_MAX,
    MapPress,
    averaged,
    frames_of_presses,
    read_contact_frames,
    read_presses,
    read_recording,
    stitcher_of,
)
from tacshade_edge.lab.studies.stitch.map_truth import comparison_png, read_known, score
from tacshade_edge.reasons import text_of
from tacshade_edge.recording.frame_table import read_poses
from tacshade_edge.recording.recording import Recording
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.sensor.profiles import PROFILES, Profile
from tacshade_edge.stitching.flange import (
    ContactFrame,
    FoundFlange,
    delay_seen,
    find_flange,
    unseen,
)
from tacshade_edge.stitching.map_files import FLANGE, press_record, write_flange, write_map
from tacshade_edge.stitching.press_agreement import suspected_poses
from tacshade_edge.stitching.refinement import correction
from tacshade_edge.stitching.stitcher import FinishedMap, Raster, Stitcher
from tacshade_edge.types import Calibration

TILES, MEAN = "tiles", "mean"
PRESSES_MIN = 12
START_MM, START_DEG = 15.0, 15.0
"""Largest plausible distance and rotation from the start; a pose found farther away is wrong."""
_MAP_FILES = ("map.npz", "map.ply", "map.png", "preview.png", "comparison.png", "map.json")
_PLAN = "(see the plan in docs/how-to/stitching.md)"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "--calibration", "CAL.npz", "from `calibrate`", required=True)
    source = parser.add_mutually_exclusive_group(required=True)
    add_option(
        source, "--poses", "POSES.csv", "table of images and the robot's poses (base_T_flange)"
    )
    add_option(
        source, "--recording", "INPUT", "a recording; each settled contact counts as one press"
    )
    # Nobody waits for a map as for a frame.
    add_profile(parser, default="accurate")
    add_option(
        parser,
        "--out",
        "DIR",
        "folder for map.npz, .ply, .png, .json and preview.png",
        required=True,
    )
    add_option(
        parser, "--truth", "PAD.npz", "score the map against this known surface and draw both"
    )
    parser.add_argument(
        "--fusion",
        choices=(TILES, MEAN),
        default=TILES,
        help="tiles: refine poses, weigh points (default); mean: the paper's average of all points",
    )
    add_flag(
        parser,
        "--find-flange",
        "find flange_T_sensor and the frames' delay, not a map: flange.json",
    )
    add_flag(parser, "--json", "print map.json (with --find-flange: flange.json)")


def run(args: argparse.Namespace) -> int:
    """Stitch; map.json lists unusable presses, and stderr also lists unreadable images,
    for which it returns 1.
    """
    if args.find_flange and args.truth is not None:
        raise ConfigError("--truth: found --find-flange as well, expected only one of the two")
    if args.find_flange and args.fusion != TILES:
        raise ConfigError("--fusion: found --find-flange as well, which makes no map")
    calibration = loading.load(args.calibration)
    # The truth is read first: a mistake in it should not wait for the presses.
    profile, known = PROFILES[args.profile], None if args.truth is None else read_known(args.truth)
    check_folder(args.out, (FLANGE,) if args.find_flange else _MAP_FILES)
    with owned_folder(args.out, "stitch"):
        return _stitch(args, calibration, profile, known)


def _stitch(
    args: argparse.Namespace, calibration: Calibration, profile: Profile, known: Raster | None
) -> int:
    """Find the presses, and the map or the flange from them."""
    start, where = from_seven(calibration.flange_T_sensor), str(args.poses or args.recording)
    apex_mm = calibration.geometry.apex_z_mm
    if args.find_flange and args.recording is not None:
        found, unread = read_contact_frames(calibration, profile, _opened(args.recording))
        for reason in unread:
            warn(f"{args.recording}: {reason.text}")
        _doubt(found, calibration, where, args)
        report_flange(found, start, apex_mm, args.out, where, as_json=args.json)
        return EXIT_FAILED if unread else EXIT_OK
    if args.recording is None:
        presses = read_presses(calibration, profile, read_poses(args.poses), Progress())
    else:
        presses = read_recording(calibration, profile, _opened(args.recording), str(args.recording))
    # A press into the air is part of a scan; an image that nobody can read is a mistake.
    failed = [press for press in presses if press.failed]
    for press in failed:
        warn(f"{press.where}: {press.skipped}")
    # The first ones, not some of all: only neighbours overlap.
    first = [press for press in presses if not press.skipped][:PRESSES_MAX]
    _doubt(frames_of_presses(first, start), calibration, where, args)
    if args.find_flange:
        frames = frames_of_presses(presses, start)
        report_flange(frames, start, apex_mm, args.out, where, as_json=args.json)
        return EXIT_FAILED if failed else EXIT_OK
    stitcher = stitcher_of(presses, apex_mm)
    if stitcher.presses == 0:
        why = presses[0].skipped if presses else "no contact settled"
        raise ConfigError(f"{where}: found no usable press: {why}")
    _write_map(args, presses, stitcher, known)
    return EXIT_FAILED if failed else EXIT_OK


def _opened(path: Path) -> Recording:
    recording = Recording(path)
    if recording.damage:
        warn(recording.damage)
    return recording


def _doubt(
    frames: Sequence[ContactFrame], calibration: Calibration, where: str, args: argparse.Namespace
) -> None:
    """Warn of poses of presses that may be in another unit or order.

    Raises ConfigError if they cannot be as they stand.
    """
    resting = [frame for frame in frames if len(frame.track) == 1]
    found = suspected_poses(
        [frame.points for frame in resting],
        [of_pose(frame.track[0]) for frame in resting],
        from_seven(calibration.flange_T_sensor),
        calibration.geometry.size_mm,
        flange_known=not args.find_flange,
    )
    if found is None:
        return
    if found.impossible:
        raise ConfigError(f"{where}: {found}")
    warn(f"{where}: {found}")


def _write_map(
    args: argparse.Namespace,
    presses: Sequence[MapPress],
    stitcher: Stitcher,
    known: Raster | None,
) -> None:
    """Write and print the map, scored against the known surface if there is one."""
    pictures = {}
    finished = averaged(presses) if args.fusion == MEAN else stitcher.finish()
    about = {"profile": args.profile, "fusion": args.fusion, **_details(presses, finished)}
    if known is not None:
        # What the paper does with the same presses, for comparison.
        average = finished if args.fusion == MEAN else averaged(presses)
        about["score"] = score(finished.raster, known).as_json()
        about["paper"] = score(average.raster, known).as_json()
        if finished.refined:
            # Once more without the refinement, to show what it is worth.
            about["unrefined"] = score(stitcher.finish(None).raster, known).as_json()
        pictures["comparison.png"] = comparison_png(known, finished.raster, average.raster)
    write_map(args.out, finished.raster, about, pictures)
    if args.json:
        print((args.out / "map.json").read_text(encoding="utf-8"), end="")
    else:
        _print(args.out, about)


def _print(out: Path, about: dict[str, Any]) -> None:
    disagreement = f"{about['disagreement_mm']:.2f} mm"
    how = f"refined (they disagreed by {disagreement})" if about["refined"] else "exact"
    print(f"{out}: {about['used']} of {len(about['presses'])} presses, poses {how}")
    for name, key in (
        ("map", "score"),
        ("not refined", "unrefined"),
        ("paper's average", "paper"),
    ):
        if key in about:
            print(f"  {name}: {_line(about[key])}")


def _details(presses: Sequence[MapPress], finished: FinishedMap) -> dict[str, Any]:
    # The map keeps the used presses in order, without the skipped ones.
    placed = iter(finished.presses)
    records = []
    for press in presses:
        record: dict[str, Any] = {
            "image": press.name,
            "used": False,
            "reason": text_of(press.skipped),
        }
        records.append(record if press.skipped else record | press_record(next(placed)))
    return {
        "refined": finished.refined,
        "disagreement_mm": round(finished.disagreement_mm, 4),
        "used": sum(record["used"] for record in records),
        "presses": records,
    }


def _line(s: dict[str, Any]) -> str:
    # Of a flat surface, nothing is raised that could be covered.
    covered = "nothing" if s["raised_coverage"] is None else f"{100 * s['raised_coverage']:.1f} %"
    return f"RMS {s['rms_mm']:.3f} mm over {s['covered_mm2']:.0f} mm², raised {covered} covered"


def report_flange(
    frames: Sequence[ContactFrame],
    start: Rigid,
    apex_mm: float,
    out: Path,
    where: str,
    *,
    as_json: bool,
) -> None:
    """Find, write and print flange_T_sensor and the delay.

    Raises ConfigError if the presses do not determine them.
    """
    presses = len({frame.press for frame in frames})
    if presses < PRESSES_MIN:
        expected = f"expected at least {PRESSES_MIN} presses {_PLAN}"
        raise ConfigError(f"{where}: found {presses} presses with a pose, {expected}")
    try:
        found = find_flange(frames, start, apex_mm)
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}") from None
    if why := unseen(found):
        raise ConfigError(f"{where}: {why} {_PLAN}")
    moved_mm, turned_deg = correction(start, found.flange_T_sensor, np.zeros(3))
    if moved_mm > START_MM or turned_deg > START_DEG:
        raise ConfigError(
            f"{where}: found flange_T_sensor {moved_mm:.0f} mm and {turned_deg:.0f} degrees from "
            f"the calibration's, expected at most {START_MM:g} mm and {START_DEG:g} degrees; is "
            "base_T_flange in mm?"
        )
    write_flange(out, found, delay_seen=delay_seen(found), presses=presses, frames=len(frames))
    if as_json:
        print((out / FLANGE).read_text(encoding="utf-8"), end="")
        return
    print(
        f"{out / FLANGE}: {presses} presses; {moved_mm:.2f} mm and {turned_deg:.2f} degrees from "
        "the calibration's"
    )
    _print_flange(found)


def _print_flange(found: FoundFlange) -> None:
    """Print the line for SENSOR.yaml, and the delay."""
    sigma = np.sqrt(np.diag(found.covariance))
    values = ", ".join(f"{value:.6g}" for value in found.flange_T_sensor.seven())
    within = f"within {max(sigma[:3]):.2f} mm, {max(sigma[3:6]):.2f} degrees (standard deviation)"
    print(f"in SENSOR.yaml, then calibrate again: flange_T_sensor: [{values}]  # {within}")
    if delay_seen(found):
        print(
            f"delay: frames are stamped {found.delay_ms:.1f} ms (± {sigma[6]:.1f}) "
            "later than the robot's poses"
        )
    else:
        expected = "expected a recording of presses down and up at 10 mm/s"
        print(f"delay: not found: no press moves while in contact, {expected}")
