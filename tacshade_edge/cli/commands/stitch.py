"""``tacshade-edge stitch``: combines images and the robot's poses, or a recording of both, into one large map."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tacshade_edge.cli.shared import find_flange
from tacshade_edge.cli.shared.profile_option import add_profile
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.core.profiles import PROFILES, Profile
from tacshade_edge.core.stitching.flange_equations import ContactFrame
from tacshade_edge.core.stitching.stitcher import StitchedMap
from tacshade_edge.core.stitching.surface_map import STEP_MM, Raster
from tacshade_edge.errors import ConfigError
from tacshade_edge.factories import calibrations
from tacshade_edge.reasons import text_of
from tacshade_edge.rigid import from_seven
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.stitching.map_files import press_record, write_map
from tacshade_edge.storage.tables.poses_table import read_poses
from tacshade_edge.studies.stitch.presses import (
    Press,
    all_points,
    frames_of_presses,
    read_contact_frames,
    read_presses,
    read_recording,
    stitcher_of,
)
from tacshade_edge.studies.stitch.truth import KnownSurface, comparison_png, radius_average, read_known, score
from tacshade_edge.types import Calibration

EXIT_FAILED = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--calibration", type=Path, required=True, metavar="CAL.npz", help="from `calibrate`")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--poses", type=Path, metavar="POSES.csv", help="table of images and the robot's poses (base_T_flange)"
    )
    source.add_argument(
        "--recording",
        type=Path,
        metavar="INPUT",
        help="recording that `replay` can read; each settled contact counts as one press",
    )
    add_profile(parser, default="accurate")  # a map may take longer
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for map.npz, map.ply, map.png, map.json and preview.png",
    )
    parser.add_argument(
        "--truth", type=Path, metavar="PAD.npz", help="score the map against this known surface and draw both"
    )
    parser.add_argument(
        "--find-flange",
        action="store_true",
        help=(
            "instead of a map, compute flange_T_sensor and the frame delay from overlapping presses "
            "and write them to flange.json"
        ),
    )
    parser.add_argument("--json", action="store_true", help="print map.json (with --find-flange: flange.json)")


def run(args: argparse.Namespace) -> int:
    """Stitch; map.json lists unusable presses, and stderr also lists unreadable images, for which it returns 1."""
    if args.find_flange and args.truth is not None:
        raise ConfigError(
            "--truth: found --find-flange as well, expected only one of the two; --find-flange makes no map"
        )
    calibration = calibrations.load(args.calibration)
    profile, known = PROFILES[args.profile], None if args.truth is None else read_known(args.truth)
    if args.recording is None:
        presses = read_presses(calibration, profile, read_poses(args.poses), Progress())
    elif args.find_flange:
        return _flange_of_recording(args, calibration, profile)
    else:
        presses = read_recording(calibration, profile, Recording(args.recording), str(args.recording))
    failed = [p for p in presses if p.failed]
    for press in failed:
        print(f"tacshade-edge: {press.where}: {press.skipped}", file=sys.stderr)
    if args.find_flange:
        start = from_seven(calibration.flange_T_sensor)
        _find_flange(args, calibration, frames_of_presses(presses, start))
        return EXIT_FAILED if failed else 0
    stitcher = stitcher_of(presses, calibration.geometry.skin_radius_mm)
    if stitcher.presses == 0:
        why = presses[0].skipped if presses else "no contact settled"
        raise ConfigError(f"{args.poses or args.recording}: found no usable press: {why}")
    finished = stitcher.finish()
    about, more = {"profile": args.profile, **_details(presses, finished)}, {}
    if known is not None:
        about["score"] = score(finished.raster, known).as_json()
        average = radius_average(all_points(presses), STEP_MM)
        about["paper"] = _scored(average, known)
        if finished.refined:
            about["unrefined"] = _scored(stitcher.finish(None).raster, known)
        more["comparison.png"] = comparison_png(known.raster, finished.raster, average)
    write_map(args.out, finished.raster, about, more)
    if args.json:
        print((args.out / "map.json").read_text(encoding="utf-8"), end="")
    else:
        _print(args.out, about)
    return EXIT_FAILED if failed else 0


def _flange_of_recording(args: argparse.Namespace, calibration: Calibration, profile: Profile) -> int:
    found, unread = read_contact_frames(calibration, profile, Recording(args.recording))
    for reason in unread:
        print(f"tacshade-edge: {args.recording}: {reason.text}", file=sys.stderr)
    _find_flange(args, calibration, found)
    return EXIT_FAILED if unread else 0


def _find_flange(args: argparse.Namespace, calibration: Calibration, found: Sequence[ContactFrame]) -> None:
    start, where = from_seven(calibration.flange_T_sensor), str(args.poses or args.recording)
    find_flange.run(found, start, calibration.geometry.skin_radius_mm, args.out, where, as_json=args.json)


def _details(presses: list[Press], finished: StitchedMap) -> dict[str, Any]:
    placed = iter(finished.presses)
    records = []
    for press in presses:
        record: dict[str, Any] = {
            "image": press.name,
            "used": False,
            "reason": text_of(press.skipped),
        }
        if not press.skipped:
            record |= press_record(next(placed))
        records.append(record)
    return {
        "refined": finished.refined,
        "disagreement_mm": round(finished.disagreement_mm, 4),
        "used": sum(r["used"] for r in records),
        "presses": records,
    }


def _scored(raster: Raster, known: KnownSurface) -> dict[str, Any]:
    return score(raster, known).as_json()


def _print(out: Path, about: dict[str, Any]) -> None:
    poses = (
        f"poses refined (they disagreed by {about['disagreement_mm']:.2f} mm)" if about["refined"] else "poses exact"
    )
    print(f"{out}: {about['used']} of {len(about['presses'])} presses, {poses}")
    for name, key in (("map", "score"), ("not refined", "unrefined"), ("paper's average", "paper")):
        if key in about:
            print(f"  {name}: {_line(about[key])}")


def _line(s: dict[str, Any]) -> str:
    def worst(records: list[dict[str, Any]], key: str) -> str:
        values = [abs(r[key]) for r in records if r[key] is not None]
        return f"{max(values):.2f}" if values else "-"

    covered = "nothing" if s["raised_coverage"] is None else f"{100 * s['raised_coverage']:.1f} %"  # a flat surface
    return (
        f"RMS {s['rms_mm']:.3f} mm over {s['covered_mm2']:.0f} mm², raised {covered} covered, "
        f"bars within {worst(s['bars'], 'angle_deg')}° and {worst(s['bars'], 'bent_mm')} mm, "
        f"circle within {worst(s['circles'], 'radius_percent')} %"
    )
