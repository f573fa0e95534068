"""Convert posed images or a recording to presses, presses to a map,
and both to the input of `find_flange`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.errors import ConfigError, DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.recording.frame_table import PosedImage
from tacshade_edge.recording.recording import Recording
from tacshade_edge.rigid import Rigid, from_seven, of_pose
from tacshade_edge.robot.pose_buffer import GAP_MAX_NS
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import Profile
from tacshade_edge.stitching.average import radius_average
from tacshade_edge.stitching.flange import ContactFrame
from tacshade_edge.stitching.press_points import NO_POINTS, PressPoints, RestDetector, press_points
from tacshade_edge.stitching.refinement import correction, thin_points
from tacshade_edge.stitching.stitcher import FinishedMap, PlacedPress, Stitcher
from tacshade_edge.types import F64, Calibration, Frame, Pose

_NO_CONTACT = Reason(ReasonCode.NO_CONTACT, "no contact")
_UNMEASURED = Reason(ReasonCode.NO_CONTACT, "something touches, but its depth is unknown")


@dataclass(frozen=True, slots=True)
class MapPress:
    """One image's contact; `points` is empty if the image is `skipped`:
    invalid, no contact, no pose, unreadable.
    """

    name: str
    where: str  # the line or file that states the press, for messages
    base_T_sensor: Rigid  # as the robot reported it
    points: PressPoints
    skipped: Reason | None
    failed: bool = False  # whether the image is a mistake rather than a press into the air


def read_presses(
    calibration: Calibration,
    profile: Profile,
    posed: Sequence[PosedImage],
    report: Callable[[str, int, int], None],
) -> list[MapPress]:
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
            presses.append(
                MapPress(
                    one.path.name, one.where, base_T_sensor, NO_POINTS, error.reason, failed=True
                )
            )
            continue
        result = reconstructor.step(Frame(seq=k, t_ns=0, wall_ns=0, image=image))
        points = press_points(result.height, calibration.geometry) if result.contact else NO_POINTS
        # A contact of unknown depth has no points, and is no press into the air either.
        nothing = _UNMEASURED if result.touched else _NO_CONTACT
        skipped = result.reason or (None if len(points.points_mm) else nothing)
        presses.append(
            MapPress(
                one.path.name,
                one.where,
                base_T_sensor,
                points,
                skipped,
                failed=image.shape[:2] != size,
            )
        )
    report("presses", len(posed), len(posed))
    return presses


def read_recording(
    calibration: Calibration, profile: Profile, recording: Recording, where: str
) -> list[MapPress]:
    """Reconstruct every frame; each contact that comes to rest is a press, as in the daemon.

    Unusable frames are passed over; a contact that comes
    to rest without a pose gives a skipped press.
    """
    reconstructor, rest = make_reconstructor(calibration, profile), RestDetector()
    flange_T_sensor = from_seven(calibration.flange_T_sensor)
    presses = []
    while True:
        try:
            recorded = recording.read()
        except DecodeError as error:
            presses.append(
                MapPress("", where, flange_T_sensor, NO_POINTS, error.reason, failed=True)
            )
            continue
        if recorded is None:
            return presses
        frame = recorded.frame
        result = reconstructor.step(frame)
        if result.touched:
            # It is no press, and ends none.
            continue
        # As in the daemon: only a skin at rest shows the shape, not the way into it.
        if not rest.update(result.t_ns, result.valid and result.contact, result.depth_max_mm):
            continue
        if frame.pose is None:
            no_pose = Reason(ReasonCode.NO_POSE, "the table has no pose for this image")
            presses.append(MapPress(recorded.name, where, flange_T_sensor, NO_POINTS, no_pose))
        else:
            points = press_points(result.height, calibration.geometry)
            skipped = None if len(points.points_mm) else _NO_CONTACT
            presses.append(
                MapPress(
                    recorded.name, where, of_pose(frame.pose) @ flange_T_sensor, points, skipped
                )
            )


def stitcher_of(presses: Sequence[MapPress], skin_radius_mm: float) -> Stitcher:
    """A stitcher with all presses that have points, in order.

    Raises ConfigError if their map is too large.
    """
    stitcher = Stitcher(skin_radius_mm)
    for press in presses:
        if press.skipped:
            continue
        try:
            stitcher.add(press.points, press.base_T_sensor)
        except ValueError as error:
            raise ConfigError(f"{press.where}: {error}") from None
    return stitcher


def averaged(presses: Sequence[MapPress]) -> FinishedMap:
    """The paper's map (section V-B): the points of all presses at the reported poses,
    averaged within a radius.

    Raises ConfigError if the map is too large.
    """
    used = [press for press in presses if not press.skipped]
    points_mm = [press.base_T_sensor.apply(press.points.points_mm) for press in used]
    placed = [
        PlacedPress(press.base_T_sensor, 0.0, 0.0, None, len(press.points.points_mm))
        for press in used
    ]
    raster = radius_average(np.concatenate(points_mm))
    return FinishedMap(raster, tuple(placed), disagreement_mm=0.0, refined=False)


PRESSES_MAX = 200
"""More presses are thinned evenly, because the time grows with the cube of their number."""
# Of each press, evenly spaced: down and up again, where a delay between frames and poses has
# opposite signs.
_MOVING_MAX = 4
_MOVING_MM_S, _MOVING_DEG_S = 2.0, 2.0
# Less is noise.
_DEPTH_MM = 0.5
# On each side: a delay may be that long.
_TRACK_NS = 300_000_000


def frames_of_presses(presses: Sequence[MapPress], flange_T_sensor: Rigid) -> list[ContactFrame]:
    """Contact frames of posed images, for which the robot is assumed to stand still."""
    sensor_T_flange = flange_T_sensor.inverse()
    used = [press for press in presses if not press.skipped]
    # Rounded up, so that no more than the limit remain.
    used = used[:: -(-len(used) // PRESSES_MAX) or 1]
    return [
        ContactFrame(
            thin_points(press.points),
            k,
            0,
            (Pose(0, *(press.base_T_sensor @ sensor_T_flange).seven()),),
        )
        for k, press in enumerate(used)
    ]


@dataclass(frozen=True, slots=True, eq=False)
class _Contact:
    """A frame in contact; `at` is the index of its pose in the track."""

    number: int
    at: int
    points: F64
    rests: bool


def read_contact_frames(
    calibration: Calibration, profile: Profile, recording: Recording
) -> tuple[list[ContactFrame], list[Reason]]:
    """Reconstruct every frame; keep each contact's frame at rest,
    and some in which the robot moved.

    The second list has the reasons of the frames that cannot be read.
    """
    reconstructor, rest = make_reconstructor(calibration, profile), RestDetector()
    track: list[Pose] = []
    contacts: list[_Contact] = []
    unread: list[Reason] = []
    number, touching = 0, False
    while True:
        try:
            recorded = recording.read()
        except DecodeError as error:
            unread.append(error.reason)
            continue
        if recorded is None:
            break
        frame = recorded.frame
        result = reconstructor.step(frame)
        contact = result.valid and result.contact
        if result.touched:
            # It is no press, and ends none.
            rests = False
        else:
            # A press begins when a contact does; all frames until its end share its number.
            number += contact and not touching
            touching = contact
            rests = rest.update(result.t_ns, contact, result.depth_max_mm)
        if frame.pose is None:
            continue
        # At the time of the frame: the table states its pose, not when the robot sent one.
        track.append(replace(frame.pose, t_ns=frame.t_ns))
        if not contact or not (rests or result.depth_max_mm >= _DEPTH_MM):
            continue
        if rests or _moves(track[-2:]):
            points = thin_points(press_points(result.height, calibration.geometry))
            if len(points):
                contacts.append(_Contact(number, len(track) - 1, points, rests))
    return _chosen(contacts, track), unread


def _moves(poses: Sequence[Pose]) -> bool:
    """Whether the flange moves between two poses without a gap."""
    if len(poses) == 1:
        return False
    before, after = poses
    ns = after.t_ns - before.t_ns
    if not 0 < ns <= GAP_MAX_NS:
        return False
    # At the flange itself, whose motion is looked for.
    moved_mm, turned_deg = correction(of_pose(before), of_pose(after), np.zeros(3))
    return moved_mm > _MOVING_MM_S * ns / 1e9 or turned_deg > _MOVING_DEG_S * ns / 1e9


def _chosen(contacts: Sequence[_Contact], track: Sequence[Pose]) -> list[ContactFrame]:
    numbers = sorted({contact.number for contact in contacts})
    # Rounded up, so that no more than the limit remain.
    numbers = numbers[:: -(-len(numbers) // PRESSES_MAX) or 1]
    found = []
    for press, number in enumerate(numbers):
        own = [contact for contact in contacts if contact.number == number]
        # At rest, a delay does not matter, and the frame shows the pose; in motion, it is what
        # shows.
        moving = [contact for contact in own if not contact.rests]
        even = (
            np.unique(np.linspace(0, len(moving) - 1, _MOVING_MAX + 2).round().astype(int)[1:-1])
            if moving
            else ()
        )
        for contact in [*(contact for contact in own if contact.rests), *(moving[k] for k in even)]:
            pose = track[contact.at]
            # The delay is found later: whichever it is, the pose of that time must be there.
            around = (pose,) if contact.rests else _around(track, contact.at)
            found.append(ContactFrame(contact.points, press, pose.t_ns, around))
    return found


def _around(track: Sequence[Pose], at: int) -> tuple[Pose, ...]:
    """The poses around one, without a gap."""
    first = last = at
    while first > 0 and _near(track[first - 1], track[first], track[at]):
        first -= 1
    while last + 1 < len(track) and _near(track[last + 1], track[last], track[at]):
        last += 1
    return tuple(track[first : last + 1])


def _near(pose: Pose, neighbour: Pose, middle: Pose) -> bool:
    return (
        0 < abs(pose.t_ns - neighbour.t_ns) <= GAP_MAX_NS
        and abs(pose.t_ns - middle.t_ns) <= _TRACK_NS
    )
