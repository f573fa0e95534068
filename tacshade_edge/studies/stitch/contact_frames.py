"""Convert posed images or a recording to the input of `find_flange`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tacshade_edge.core.profiles import Profile
from tacshade_edge.core.stitching.flange_equations import ContactFrame
from tacshade_edge.core.stitching.poses import GAP_MAX_NS
from tacshade_edge.core.stitching.press_points import press_points
from tacshade_edge.core.stitching.refinement import thin_points
from tacshade_edge.core.stitching.rest import RestDetector
from tacshade_edge.errors import DecodeError
from tacshade_edge.inference.network import make_reconstructor
from tacshade_edge.reasons import Reason
from tacshade_edge.rigid import Rigid, of_pose
from tacshade_edge.storage.recording.recording import Recording
from tacshade_edge.studies.stitch.work import Press
from tacshade_edge.types import F64, Calibration, Pose

PRESSES_MAX = 200
"""More presses are thinned evenly, because the time grows with the cube of their number."""
_MOVING_MAX = 4  # frames of each press, evenly spaced: down and up again
_MOVING_MM_S, _MOVING_DEG_S = 2.0, 2.0
_DEPTH_MM = 0.5  # less is noise
_TRACK_NS = 300_000_000  # on each side: a delay may be that long


def frames_of_presses(presses: Sequence[Press], flange_T_sensor: Rigid) -> list[ContactFrame]:
    """Contact frames of posed images, for which the robot is assumed to stand still."""
    sensor_T_flange = flange_T_sensor.inverse()
    used = [press for press in presses if not press.skipped]
    used = used[:: -(-len(used) // PRESSES_MAX) or 1]
    return [
        ContactFrame(thin_points(press.points), k, 0, (Pose(0, *(press.base_T_sensor @ sensor_T_flange).seven()),))
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
    """Reconstruct every frame; keep each contact's frame at rest, and some in which the robot moved.

    Returns
    -------
    found : list of ContactFrame
    unread : list of Reason
        Reasons of the frames that cannot be read.
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
        number += contact and not touching
        touching = contact
        rests = rest.update(result.t_ns, contact, result.depth_max_mm)
        if frame.pose is None:
            continue
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
    if len(poses) < 2 or not 0 < (ns := poses[1].t_ns - poses[0].t_ns) <= GAP_MAX_NS:
        return False
    a, b = of_pose(poses[0]), of_pose(poses[1])
    cosine = (np.trace(a.rotation.T @ b.rotation) - 1) / 2
    turned_deg = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    moved_mm = float(np.linalg.norm(b.translation_mm - a.translation_mm))
    return moved_mm > _MOVING_MM_S * ns / 1e9 or turned_deg > _MOVING_DEG_S * ns / 1e9


def _chosen(contacts: Sequence[_Contact], track: Sequence[Pose]) -> list[ContactFrame]:
    numbers = sorted({contact.number for contact in contacts})
    numbers = numbers[:: -(-len(numbers) // PRESSES_MAX) or 1]
    found = []
    for press, number in enumerate(numbers):
        own = [contact for contact in contacts if contact.number == number]
        moving = [contact for contact in own if not contact.rests]
        even = np.unique(np.linspace(0, len(moving) - 1, _MOVING_MAX + 2).round().astype(int)[1:-1]) if moving else ()
        for contact in [*(contact for contact in own if contact.rests), *(moving[k] for k in even)]:
            pose = track[contact.at]
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
    return 0 < abs(pose.t_ns - neighbour.t_ns) <= GAP_MAX_NS and abs(pose.t_ns - middle.t_ns) <= _TRACK_NS
