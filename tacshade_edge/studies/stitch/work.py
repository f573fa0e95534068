"""Convert posed images or a recording to presses, and presses to a map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.stitching.press_points import NO_POINTS, PressPoints, press_points
from tacshade_edge.core.stitching.rest import RestDetector
from tacshade_edge.core.stitching.stitcher import Stitcher
from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.storage.images import read_image
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.storage.tables.poses_table import PosedImage
from tacshade_edge.types import F64, Calibration, Frame

AVERAGED_POINTS = 500
"""The paper's average visits every pair in its radius: ten times the points need a hundred times the memory."""
_NO_CONTACT = Reason(ReasonCode.NO_CONTACT, "no contact")


@dataclass(frozen=True, slots=True)
class Press:
    """One image's contact.

    Attributes
    ----------
    name : str
        Name of the image.
    where : str
        The line or file that states the press, for messages.
    base_T_sensor : Rigid
        Pose that the robot reported.
    points : PressPoints
        Empty if `skipped` is set.
    skipped : Reason or None
        Why the image adds nothing: invalid, no contact, no pose, unreadable.
    failed : bool
        Whether the image is a mistake rather than a press into the air.
    """

    name: str
    where: str
    base_T_sensor: Rigid
    points: PressPoints
    skipped: Reason | None
    failed: bool = False


def read_presses(
    calibration: Calibration, profile: Profile, posed: Sequence[PosedImage], report: Callable[[str, int, int], None]
) -> list[Press]:
    """Reconstruct the press of every image."""
    reconstructor = make_reconstructor(calibration, profile)
    flange_T_sensor = from_seven(calibration.flange_T_sensor)
    size = (calibration.image_height_px, calibration.image_width_px)
    presses = []
    for k, one in enumerate(posed):
        report("presses", k, len(posed))
        base_T_sensor = one.base_T_flange @ flange_T_sensor
        try:
            image = read_image(one.path)
        except DecodeError as error:
            presses.append(Press(one.path.name, one.where, base_T_sensor, NO_POINTS, error.reason, failed=True))
            continue
        result = reconstructor.step(Frame(seq=k, t_ns=0, wall_ns=0, image=image))
        points = press_points(result.height, calibration.geometry) if result.contact else NO_POINTS
        skipped = result.reason or (None if len(points.points_mm) else _NO_CONTACT)
        presses.append(Press(one.path.name, one.where, base_T_sensor, points, skipped, failed=image.shape[:2] != size))
    report("presses", len(posed), len(posed))
    return presses


def read_recording(calibration: Calibration, profile: Profile, recording: Recording, where: str) -> list[Press]:
    """Reconstruct every frame; each contact that comes to rest is a press, as in the daemon.

    Unusable frames are passed over; a contact that comes to rest without a pose gives a skipped press.
    """
    reconstructor, rest = make_reconstructor(calibration, profile), RestDetector()
    flange_T_sensor = from_seven(calibration.flange_T_sensor)
    presses = []
    while True:
        try:
            recorded = recording.read()
        except DecodeError as error:
            presses.append(Press("", where, flange_T_sensor, NO_POINTS, error.reason, failed=True))
            continue
        if recorded is None:
            return presses
        frame = recorded.frame
        result = reconstructor.step(frame)
        if not rest.update(result.t_ns, result.valid and result.contact, result.depth_max_mm):
            continue
        if frame.pose is None:
            no_pose = Reason(ReasonCode.NO_POSE, "the table has no pose for this image")
            presses.append(Press(recorded.name, where, flange_T_sensor, NO_POINTS, no_pose))
        else:
            points = press_points(result.height, calibration.geometry)
            skipped = None if len(points.points_mm) else _NO_CONTACT
            presses.append(Press(recorded.name, where, of_pose(frame.pose) @ flange_T_sensor, points, skipped))


def stitcher_of(presses: Sequence[Press], skin_radius_mm: float) -> Stitcher:
    """A stitcher with all presses that have points, in order. Raises ConfigError if their map is too large."""
    stitcher = Stitcher(skin_radius_mm)
    for press in presses:
        if press.skipped:
            continue
        try:
            stitcher.add(press.points, press.base_T_sensor)
        except ValueError as error:
            raise ConfigError(f"{press.where}: {error}") from None
    return stitcher


def all_points(presses: Sequence[Press]) -> F64:
    """Points (N, 3) in mm of all presses at the reported poses; evenly thinned to `AVERAGED_POINTS` of each."""
    parts = []
    for press in presses:
        if not press.skipped:
            every = -(-len(press.points.points_mm) // AVERAGED_POINTS)
            parts.append(press.base_T_sensor.apply(press.points.points_mm[::every]))
    return np.concatenate(parts)
