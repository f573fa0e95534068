"""A stitching session: its presses, on disk and in the map, and the messages about it."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.errors import DeviceError
from tacshade_edge.files.atomic_files import disk_errors, free_name
from tacshade_edge.plausibility.suspicions import Suspicion
from tacshade_edge.quoting import quoted
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.rigid import Rigid, from_seven
from tacshade_edge.stitching.map_files import press_record, write_map
from tacshade_edge.stitching.press_agreement import suspected_poses
from tacshade_edge.stitching.press_points import PressPoints
from tacshade_edge.stitching.stitch_file import SessionInfo, StitchFile, open_session
from tacshade_edge.stitching.stitcher import FinishedMap, Raster, Stitcher
from tacshade_edge.types import F32, Calibration
from tacshade_edge.wire.binary import encode_map_cloud
from tacshade_edge.wire.codec import encode_json
from tacshade_edge.wire.requests import RECORD_NAME, RECORD_NAME_RULE
from tacshade_edge.wire.results import PressAdded, SessionEnded, SessionStatus
from tacshade_edge.wire.sensor_topics import StitchedMap


@dataclass(frozen=True, slots=True)
class MapRevision:
    """The map after a press, or the final one, whose files are in `folder`;
    `raster` makes it, at a cost that grows with it.
    """

    name: str
    revision: int
    presses: int
    used: int
    calibration_crc32: int
    folder: str
    raster: Callable[[], Raster]


# A raster's cost grows with the map, and a robot may press several times a second.
PERIOD_S = 1.0
POINTS_MAX = 20_000
"""Most points of a ``map/cloud``, 280 kB; a larger map is thinned."""


class MapPublisher:
    """Publishes ``map/revision`` and ``map/cloud`` at most once a second as a map grows,
    then ``map/final``.
    """

    def __init__(self, publish: Callable[[str, bytes], None]) -> None:
        self._publish = publish
        self._next_s = 0.0

    def publish(self, revision: MapRevision) -> bool:
        """Publish a revision; return True if it is deferred because one was just published.

        The final one never is.
        """
        now_s = time.monotonic()
        if not revision.folder and now_s < self._next_s:
            return True
        self._next_s = now_s + PERIOD_S
        raster = revision.raster()
        points, spacing_mm = thinned_points(raster)
        known = raster.z_mm[np.isfinite(raster.z_mm)]
        length_mm, width_mm = (size * raster.step_mm for size in raster.z_mm.shape)
        about = StitchedMap(
            name=revision.name,
            revision=revision.revision,
            presses=revision.presses,
            used=revision.used,
            x0_mm=raster.x0_mm,
            y0_mm=raster.y0_mm,
            width_mm=width_mm,
            length_mm=length_mm,
            z_min_mm=float(known.min()) if known.size else None,
            z_max_mm=float(known.max()) if known.size else None,
            area_mm2=known.size * raster.step_mm**2,
            points=len(points),
            spacing_mm=spacing_mm,
            folder=revision.folder,
        )
        numbers = {"revision": revision.revision, "calibration_crc32": revision.calibration_crc32}
        cloud = encode_map_cloud(
            points, **numbers, t_ns=time.monotonic_ns(), wall_ns=time.time_ns()
        )
        self._publish("map/cloud", cloud)
        self._publish("map/final" if revision.folder else "map/revision", encode_json(about))
        return False


def thinned_points(raster: Raster) -> tuple[F32, float]:
    """Points (N, 3) of every k-th row and column, with the least k for `POINTS_MAX`,
    and their spacing in mm.
    """
    stride = 1
    while np.count_nonzero(np.isfinite(raster.z_mm[::stride, ::stride])) > POINTS_MAX:
        stride += 1
    spacing_mm = stride * raster.step_mm
    thin = Raster(raster.z_mm[::stride, ::stride], raster.x0_mm, raster.y0_mm, spacing_mm)
    return thin.points().astype(np.float32), spacing_mm


class StitchSession:
    """An open session, for one thread at a time; its stitcher has the presses of its file."""

    def __init__(self, file: StitchFile, stitcher: Stitcher) -> None:
        self.file = file
        self._stitcher = stitcher
        self.revision = stitcher.presses
        self.name, self.folder = file.info.name, file.folder

    @classmethod
    def begin(
        cls, folder: Path, name: str, calibration: Calibration, sensor_id: str
    ) -> StitchSession:
        """Begin a session in a new folder, by default named by the time in UTC.

        Raises DeviceError.
        """
        name = name or free_name(folder).name
        if not re.match(RECORD_NAME, name):
            raise DeviceError(
                f"found {quoted(name)}, expected {RECORD_NAME_RULE}", code=ReasonCode.BAD_NAME
            )
        with disk_errors(folder):
            exists = (folder / name).exists()
        if exists:
            raise DeviceError(f"{folder / name} already exists", code=ReasonCode.NAME_TAKEN)
        info = SessionInfo(
            name, time.time_ns(), calibration.crc32, calibration.geometry.apex_z_mm, sensor_id
        )
        return cls(StitchFile.create(folder / name, info), Stitcher(info.skin_radius_mm))

    @classmethod
    def resume(cls, folder: Path, sensor_id: str) -> StitchSession | None:
        """Resume the sensor's session below `folder` that has not ended; None if none.

        Raises TacshadeError.
        """
        with disk_errors(folder):
            path = open_session(folder, sensor_id)
        if path is None:
            return None
        file, presses = StitchFile.resume(path)
        stitcher = Stitcher(file.info.skin_radius_mm)
        for points, base_T_sensor in presses:
            with contextlib.suppress(ValueError):  # it was refused when it came, too
                stitcher.add(points, base_T_sensor)
        return cls(file, stitcher)

    @property
    def presses(self) -> int:
        return self._stitcher.presses

    @property
    def points(self) -> int:
        return self._stitcher.points

    def status(self, missed: int) -> SessionStatus:
        """The session's status; `missed` counts the contacts at rest that were not added."""
        tiles = self._stitcher.map.tiles
        return SessionStatus(self.name, self.presses, self.points, tiles, self.revision, missed)

    def add(self, points: PressPoints, base_T_sensor: Rigid, frame_seq: int) -> PressAdded:
        """Add a press; it is on the disk when this returns.

        Raises DeviceError (MAP_FULL if it has no room).
        """
        # Disk first, so that an acknowledged press is stored.
        # After a crash here the map refuses it again on resuming.
        self.file.append(points, base_T_sensor)
        try:
            self._stitcher.add(points, base_T_sensor)
        except ValueError as error:
            self.file.take_back()
            raise DeviceError(str(error), code=ReasonCode.MAP_FULL) from None
        self.revision += 1
        return PressAdded(self.presses, frame_seq, len(points.points_mm))

    def map_revision(self) -> MapRevision:
        # The function, not its raster: most revisions are never published.
        crc32, raster = self.file.info.calibration_crc32, self._stitcher.map.raster
        return MapRevision(self.name, self.revision, self.presses, self.presses, crc32, "", raster)

    def suspected(self, calibration: Calibration) -> Suspicion | None:
        """What is wrong with the poses of its presses; None if nothing is."""
        flange_T_sensor = from_seven(calibration.flange_T_sensor)
        sensor_T_flange = flange_T_sensor.inverse()
        thinned = self._stitcher.thinned
        return suspected_poses(
            [points for points, _ in thinned],
            [base_T_sensor @ sensor_T_flange for _, base_T_sensor in thinned],
            flange_T_sensor,
            calibration.geometry.size_mm,
        )

    def finish(
        self,
        missed: int,
        suspected: Suspicion | None = None,
        check_wanted: Callable[[], None] = lambda: None,
    ) -> tuple[SessionEnded, MapRevision]:
        """Make the final map and write its files, which takes seconds; `suspected` is said in them.
        What `check_wanted` raises once the map is made keeps the session open.

        Raises DeviceError: it is still open.
        """
        final = self._stitcher.finish()
        check_wanted()
        raster, crc32 = final.raster, self.file.info.calibration_crc32
        used = sum(press.rejected is None for press in final.presses)
        self.revision += 1
        details = self._details(final, used, missed, suspected)
        # The map first: after a crash between the two, the session is still open, and END makes the
        # same map again.
        write_map(self.folder, raster, details)
        self.file.end()
        area_mm2 = float(np.count_nonzero(np.isfinite(raster.z_mm))) * raster.step_mm**2
        return (
            SessionEnded(
                self.name,
                self.presses,
                used,
                final.refined,
                final.disagreement_mm,
                area_mm2,
                *_words(suspected),
            ),
            MapRevision(
                self.name,
                self.revision,
                self.presses,
                used,
                crc32,
                str(self.folder),
                lambda: raster,
            ),
        )

    def _details(
        self, final: FinishedMap, used: int, missed: int, suspected: Suspicion | None
    ) -> dict[str, Any]:
        """What ``map.json`` says of the final map and its presses."""
        return {
            "name": self.name,
            "revision": self.revision,
            "used": used,
            "missed": missed,
            "refined": final.refined,
            "disagreement_mm": round(final.disagreement_mm, 4),
            "suspected": "" if suspected is None else str(suspected),
            "calibration_crc32": self.file.info.calibration_crc32,
            "presses": [
                {"press": k, **press_record(press)}
                for k, press in enumerate(final.presses, start=1)
            ],
        }


def _words(found: Suspicion | None) -> tuple[str, str]:
    """A suspicion's code and unit, as the serial line's ASCII words."""
    if found is None:
        return "", ""
    return found.code.name.lower(), str(found.values.get("unit", "")).replace("µ", "u")
