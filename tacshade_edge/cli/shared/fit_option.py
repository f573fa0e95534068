"""``calibrate --fit``: what it needs, its touches, and its steps, kept until the result is safe."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tacshade_edge.calibration.calibrate import CalibrationResult
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.cli.shared.options import need
from tacshade_edge.errors import ConfigError, DecodeError, DeviceError
from tacshade_edge.files.atomic_files import disk_errors
from tacshade_edge.files.images import images_in, read_image, size_text
from tacshade_edge.files.targets import check_folder
from tacshade_edge.sensor.depth.learned import FLAT_DEG
from tacshade_edge.types import U8

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.fit import FitResult

_STEPS = "fit-*.npz"
_HELD = "finished"


def check_fit(path: Path, sensor: StatedSensor, out: Path) -> None:
    """Refuse a sensor that no fit can simulate, a missing extra, or steps that cannot be kept.

    Raises ConfigError and DeviceError.
    """
    if sensor.visible_half_angle_deg < FLAT_DEG:
        raise ConfigError(
            f"--fit: {path} states a pad or a dome of less than {FLAT_DEG:g} degrees, "
            "expected a rounder one: a fit simulates no twin of a flat skin"
        )
    # Large, so an extra; asked for before minutes of work.
    need("--fit", "fit", "torch", "numba")
    check_folder(_folder_of(out))


def read_touches(paths: Sequence[Path], reference: U8) -> list[U8]:
    """Read the pictures of touches, of the references' size. Raises ConfigError."""
    made = []
    for path in images_in(paths):
        try:
            image = read_image(path)
        except DecodeError as error:
            raise ConfigError(f"--touches: {error}") from None
        if size_text(image) != size_text(reference):
            expected = f"expected {size_text(reference)} px as in the references"
            raise ConfigError(f"--touches: {path}: found {size_text(image)} px, {expected}")
        made.append(image)
    return made


class KeptFit:
    """Fits, and holds on to the finished steps, which `fit` removes, by second names
    of their files.
    """

    def __init__(self, out: Path) -> None:
        self._folder = _folder_of(out)
        self._held = self._folder / _HELD
        # Of a run that was killed after its fit and before its result was written.
        self._put_back()

    def run(
        self, sensor: StatedSensor, result: CalibrationResult, touches: Sequence[U8]
    ) -> FitResult:
        """Train the networks on a simulated twin; finished steps stay beside the result."""
        from tacshade_edge.lab.fitting.fit import fit

        try:
            return fit(
                result.calibration,
                result.presses,
                self._say,
                sensor.print_mm,
                self._folder,
                touches=touches,
            )
        except BaseException:
            # The steps are where they were: a second name would bring back a damaged one.
            shutil.rmtree(self._held, ignore_errors=True)
            raise

    def remove(self) -> None:
        """Remove the steps of a fit whose result is safe."""
        shutil.rmtree(self._held, ignore_errors=True)
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def put_back(self) -> bool:
        """Give back what a fit removed whose result is not safe; return whether there was
        something.
        """
        with disk_errors(self._folder):
            return self._put_back()

    def _say(self, line: str) -> None:
        # `fit` says each part of its work as it ends, the last one before it removes the steps.
        self._hold()
        print(line, file=sys.stderr, flush=True)

    def _hold(self) -> None:
        """Give each finished step a second name, which takes no space."""
        # A disk without second names, such as an SD card's FAT, keeps no step beyond the fit.
        with contextlib.suppress(OSError):
            steps = {path.name for path in self._folder.glob(_STEPS)}
            if not steps:
                return
            self._held.mkdir(exist_ok=True)
            for path in self._held.glob(_STEPS):
                # `fit` has removed a damaged step, or one of another fit.
                if path.name not in steps:
                    path.unlink()
            for name in steps:
                with contextlib.suppress(FileExistsError):
                    os.link(self._folder / name, self._held / name)

    def _put_back(self) -> bool:
        names = [path.name for path in self._held.glob(_STEPS)]
        for name in names:
            os.replace(self._held / name, self._folder / name)
        shutil.rmtree(self._held, ignore_errors=True)
        return bool(names)


@contextlib.contextmanager
def kept_until_written(out: Path) -> Iterator[KeptFit]:
    """A fit to `out` whose steps are removed when the block ends, and kept if that raises."""
    with disk_errors(out):
        kept = KeptFit(out)
    try:
        yield kept
    except DeviceError as error:
        if not kept.put_back():
            raise
        again = "the trained networks are kept; to write them, run the same command again"
        raise DeviceError(f"{error}; {again}", code=error.code) from None
    except BaseException:
        kept.put_back()
        raise
    kept.remove()


def _folder_of(out: Path) -> Path:
    """Where the finished steps of a fit to `out` are found again."""
    return out.with_name(f"{out.name}.fit")


def fit_report(fitted: FitResult) -> dict[str, Any]:
    """What ``--json`` prints of a fit."""
    reports = {report.name: asdict(report) | {"kept": report.kept} for report in fitted.networks}
    for report in reports.values():
        del report["name"]
    return {"fitted": reports, "fit_found": list(fitted.found), "fit_to_do": list(fitted.advice)}
