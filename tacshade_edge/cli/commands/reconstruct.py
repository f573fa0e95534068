"""``tacshade-edge reconstruct``: turns images into height maps, clouds and a summary."""

from __future__ import annotations

import argparse
import io
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.cli import EXIT_FAILED, EXIT_OK
from tacshade_edge.cli.shared.options import add_flag, add_option, add_outline, add_profile, warn
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.atomic_files import disk_errors, write_whole
from tacshade_edge.files.drawing import (
    SHEET_TILES,
    Tile,
    colours,
    contact_sheet,
    panel,
    tile,
    write_picture,
)
from tacshade_edge.files.images import images_in, read_image
from tacshade_edge.files.meshes import surface_ply
from tacshade_edge.files.targets import check_folder, owned_folder
from tacshade_edge.pipeline.ledger import StageTimer
from tacshade_edge.quoting import encodable
from tacshade_edge.reasons import ReasonCode, code_of, text_of
from tacshade_edge.recording.runs import summary
from tacshade_edge.sensor.geometry.disc import skin_points
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import profile_with
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import U8, Calibration, Frame, Geometry, Reconstruction

_SUMMARY = "summary.json"


def sheet_name(number: int) -> str:
    """The file of a contact sheet, from 0."""
    return f"contact-sheet-{number + 1}.png" if number else "contact-sheet.png"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_option(parser, "--calibration", "CAL.npz", "from `calibrate`", required=True)
    add_profile(parser)
    add_outline(parser)
    add_option(
        parser, "--out", "DIR", "folder for summary.json and one .npz file per image", required=True
    )
    text = (
        "also write a picture of each image's height map, and contact sheets of "
        f"{SHEET_TILES} images each: {sheet_name(0)}, {sheet_name(1)}, ..."
    )
    add_flag(parser, "--plot", text)
    text = "also write the skin of each usable image as a surface in mm, STEM.ply"
    add_flag(parser, "--mesh", text)
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
    images = images_in(args.images)
    _check_names(images)
    calibration = loading.load(args.calibration)
    ends = (".npz", *[".png"] * args.plot, *[".ply"] * args.mesh)
    named = (f"{path.stem}{end}" for path in images for end in ends)
    sheets = (sheet_name(k) for k in range(math.ceil(len(images) / SHEET_TILES)))
    check_folder(args.out, (_SUMMARY, *sheets, *named))
    done = _Done()
    with owned_folder(args.out, "reconstruct"), disk_errors(args.out):
        # It describes all files beside it: an old one must not stand beside new files.
        (args.out / _SUMMARY).unlink(missing_ok=True)
        _reconstruct(args, calibration, images, done)
        if done.tiles:
            _write_sheet(args.out, done)
        text = json.dumps(done.records, indent=2) + "\n"
        write_whole(args.out / _SUMMARY, text.encode())
    print(text if args.json else f"{args.out}: {done.in_words(len(images))}\n", end="")
    if 1 < done.invalid == len(done.records):
        warn(
            f"every image is invalid: are they of {args.calibration}'s sensor? `tacshade-edge "
            "doctor IMG... --calibration CAL.npz` shows which judge refuses them"
        )
    return EXIT_FAILED if done.invalid or done.unreadable else EXIT_OK


@dataclass(slots=True)
class _Done:
    """What the images gave so far."""

    records: list[dict[str, Any]] = field(default_factory=list)
    tiles: list[Tile] = field(default_factory=list)  # of the next sheet
    sheets: int = 0
    unreadable: int = 0
    invalid: int = 0

    def in_words(self, images: int) -> str:
        """The counts in one line."""
        contacts, unmeasured = (
            sum(record[name] is True for record in self.records) for name in ("contact", "touched")
        )
        measured = len(self.records) - self.invalid
        found = f"{measured} of {images} images reconstructed, {contacts} in contact"
        found += f", {unmeasured} touched (depth unknown)" if unmeasured else ""
        found += f", {self.invalid} invalid, {self.unreadable} unreadable"
        return f"{found}; {self.sheets} contact sheets" if self.sheets > 1 else found


def _check_names(images: Sequence[Path]) -> None:
    """Refuse images whose results would have the same name. Raises ConfigError."""
    stems = set[str]()
    for path in images:
        if path.stem in stems:
            why = "the results of one would overwrite those of the other"
            raise ConfigError(f"{path}: another image is also named {path.stem}; {why}")
        stems.add(path.stem)


def _reconstruct(
    args: argparse.Namespace, calibration: Calibration, images: Sequence[Path], done: _Done
) -> None:
    """Reconstruct each image, write its files, and add what it gave to `done`."""
    reconstructor = make_reconstructor(calibration, profile_with(args.profile, args.outline))
    progress, timer = Progress(), StageTimer()
    for index, path in enumerate(images):
        try:
            image = read_image(path)
        except DecodeError as error:
            progress.warn(error)
            done.unreadable += 1
            continue
        timer.begin()
        result = reconstructor.step(Frame(seq=index, t_ns=0, wall_ns=0, image=image), timer.mark)
        timer.ms["total"] = sum(timer.ms.values())
        elapsed_ms = {stage: round(ms, 4) for stage, ms in timer.ms.items()}
        _write(args.out / f"{path.stem}.npz", result)
        if args.plot:
            _draw(args.out, path.stem, image, result, calibration.geometry, done)
        # The height of an invalid image is 0, as of the untouched skin.
        if args.mesh and result.valid:
            _write_surface(args.out / f"{path.stem}.ply", result, reconstructor)
        named = encodable(str(path))
        done.records.append({"image": named, **summary(result), "elapsed_ms": elapsed_ms})
        # Its record reports this too, but its height is 0 everywhere, as of no contact.
        if not result.valid:
            progress.warn(f"{path}: invalid: {text_of(result.reason)}")
            done.invalid += 1
        progress("images", index + 1, len(images))
    progress.end()


def _draw(
    out: Path, stem: str, image: U8, result: Reconstruction, geometry: Geometry, done: _Done
) -> None:
    write_picture(out / f"{stem}.png", panel(image, result, geometry))
    # The map of a picture of another size would not lie over it.
    if code_of(result.reason) != ReasonCode.SIZE:
        done.tiles.append(tile(stem, image, result, geometry.disc))
    if len(done.tiles) == SHEET_TILES:
        _write_sheet(out, done)


def _write_sheet(out: Path, done: _Done) -> None:
    write_picture(out / sheet_name(done.sheets), contact_sheet(done.tiles))
    done.sheets += 1
    done.tiles.clear()


def _write_surface(path: Path, result: Reconstruction, reconstructor: Reconstructor) -> None:
    height_mm = result.height.height_mm
    points_mm = skin_points(height_mm, reconstructor.rays, reconstructor.calibration.geometry)
    top = max(float(np.nanmax(height_mm, initial=0.0)), 0.1)
    comment = "skin in millimetres, sensor frame; quality is the height in mm"
    coloured = colours(height_mm, 0.0, top, 255)
    write_whole(path, surface_ply(points_mm, height_mm, coloured, comment), sync=False)


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
    # Always there, so that a reader needs no case for it.
    arrays["untrusted"] = (
        np.zeros(height.contact.shape, bool) if result.untrusted is None else result.untrusted
    )
    stream = io.BytesIO()
    np.savez_compressed(
        stream, **arrays, points_mm=cloud.points_mm, labels=cloud.labels.astype(np.int32)
    )
    # To wait for the disk takes longer than an image; after a power cut, the command is repeated.
    write_whole(path, stream.getvalue(), sync=False)
