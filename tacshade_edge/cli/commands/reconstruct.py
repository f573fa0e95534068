"""``tacshade-edge reconstruct``: turns images into height maps, clouds and a summary."""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.cli.shared.options import add_flag, add_option, add_outline, add_profile
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.drawing import SHEET_TILES, Tile, contact_sheet, panel, tile, write_picture
from tacshade_edge.files.images import images_in, read_image
from tacshade_edge.pipeline.ledger import StageTimer
from tacshade_edge.quoting import encodable
from tacshade_edge.reasons import text_of
from tacshade_edge.recording.runs import summary
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import profile_with
from tacshade_edge.types import Frame, Reconstruction

SHEET = "contact-sheet.png"

_SUMMARY = "summary.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "--calibration", "CAL.npz", "from `calibrate`", required=True)
    add_profile(parser)
    add_outline(parser)
    add_option(
        parser, "--out", "DIR", "folder for summary.json and one .npz file per image", required=True
    )
    text = (
        "also write a picture of each image's height map, "
        f"and {SHEET} of at most {SHEET_TILES} images"
    )
    add_flag(parser, "--plot", text)
    add_flag(parser, "--json", "print the summary as JSON")
    add_option(
        parser,
        "images",
        "IMG",
        "image, or folder whose images are taken in the order of their names",
        nargs="+",
    )


def run(args: argparse.Namespace) -> int:
    """Reconstruct every image; report each unreadable or invalid one, continue,
    and then return 1.
    """
    images, stems = images_in(args.images), set[str]()
    for path in images:
        if path.stem in stems:
            why = "the results of one would overwrite those of the other"
            raise ConfigError(f"{path}: another image is also named {path.stem}; {why}")
        stems.add(path.stem)
    calibration = loading.load(args.calibration)
    reconstructor = make_reconstructor(calibration, profile_with(args.profile, args.outline))
    records, unreadable, invalid, progress, tiles, timer = (
        [],
        0,
        0,
        Progress(),
        list[Tile](),
        StageTimer(),
    )
    on_sheet = {
        index * len(images) // SHEET_TILES for index in range(SHEET_TILES)
    }  # all, or evenly spread
    with disk_errors(args.out):
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / _SUMMARY).unlink(missing_ok=True)  # it describes all files beside it
        for index, path in enumerate(images):
            try:
                image = read_image(path)
            except DecodeError as error:
                progress.warn(error)
                unreadable += 1
                continue
            timer.begin()
            result = reconstructor.step(
                Frame(seq=index, t_ns=0, wall_ns=0, image=image), timer.mark
            )
            timer.ms["total"] = sum(timer.ms.values())
            elapsed_ms = {stage: round(ms, 4) for stage, ms in timer.ms.items()}
            _write(args.out / f"{path.stem}.npz", result)
            if args.plot:
                write_picture(
                    args.out / f"{path.stem}.png", panel(image, result, calibration.geometry)
                )
                if index in on_sheet:
                    tiles.append(tile(path.stem, image, result))
            records.append(
                {"image": encodable(str(path)), **summary(result), "elapsed_ms": elapsed_ms}
            )
            if not result.valid:  # its record reports this too, and its height is 0 everywhere
                progress.warn(f"{path}: invalid: {text_of(result.reason)}")
                invalid += 1
            progress("images", index + 1, len(images))
        if tiles:
            write_picture(args.out / SHEET, contact_sheet(tiles))
        text = json.dumps(records, indent=2) + "\n"
        write_whole(args.out / _SUMMARY, text.encode())
    progress.end()
    if args.json:
        print(text, end="")
    else:
        contacts, unmeasured = (
            sum(record[name] for record in records) for name in ("contact", "touched")
        )
        measured = len(records) - invalid
        found = f"{measured} of {len(images)} images reconstructed, {contacts} in contact"
        found += f", {unmeasured} touched (depth unknown)" if unmeasured else ""
        print(f"{args.out}: {found}, {invalid} invalid, {unreadable} unreadable")
    return 1 if invalid or unreadable else 0


def _write(path: Path, result: Reconstruction) -> None:
    height, cloud = result.height, result.cloud
    arrays = {
        name: getattr(height, name) for name in ("height_mm", "contact", "row0", "col0", "step_px")
    }
    arrays |= {
        name: getattr(result, name)
        for name in ("shear_mm", "sigma_mm")
        if getattr(result, name) is not None
    }
    arrays["untrusted"] = (
        np.zeros(height.contact.shape, bool) if result.untrusted is None else result.untrusted
    )
    stream = io.BytesIO()
    np.savez_compressed(
        stream, **arrays, points_mm=cloud.points_mm, labels=cloud.labels.astype(np.int32)
    )
    write_whole(path, stream.getvalue(), sync=False)
