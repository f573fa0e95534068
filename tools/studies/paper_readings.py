"""The paper's Experiment 1 on simulated frames, for every reading of what its text leaves open.

A press's α is its own: the ratio of its true depth to its greatest estimate (section IV-C).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tacshade_edge.calibration.calibrate import calibrate
from tacshade_edge.calibration.inputs import StatedSensor
from tacshade_edge.lab.simulator.press import OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedSensor, Truth
from tacshade_edge.lab.studies.evaluate.score import CloudScore, score_cloud
from tacshade_edge.lab.studies.evaluate.work import REFERENCE_NOISE, SCENE_NOISE
from tacshade_edge.sensor.contact.objects import two_means_split
from tacshade_edge.sensor.depth.hybrid_iteration import HybridIteration
from tacshade_edge.sensor.depth.hybrid_sfs import hybrid_depth, unit_by_grey
from tacshade_edge.sensor.geometry.disc import skin_points
from tacshade_edge.sensor.image.preprocess import GreyMapper, GreyMaps, Preprocessor
from tacshade_edge.sensor.profiles import PROFILES, Profile
from tacshade_edge.types import F32, U8, Bool, Calibration, frozen

REFERENCES = 4
REGISTERED_POINTS, REGISTRATIONS = 400, 10


@dataclass(frozen=True, slots=True)
class Reading:
    """One way to read the paper: eq. 1's window, the weight of the total variation, whether eq. 9
    saturates at 0 as unsigned integers do, whether eq. 13 compares clouds after the found one is
    moved onto the true one, and the stride of eq. 1's window.
    """

    window_pitches: int = 2
    tv_weight: float = 0.1
    saturates: bool = False
    registered: bool = False
    stride_px: int = 4

    @property
    def profile(self) -> Profile:
        """The profile `paper` with this window and weight."""
        return replace(
            PROFILES["paper"],
            window_pitches=self.window_pitches,
            tv_weight=self.tv_weight,
            stride_px=self.stride_px,
        )


@frozen
class PressedObject:
    """A picture (BGR) of one of Table I's objects, and its truth."""

    name: str
    image: U8
    truth: Truth


@frozen
class PaperMap:
    """What the paper's Fig. 6 shows of a press: the maps of eqs.
    9 and 10, the heights in mm, the object's cells.
    """

    maps: GreyMaps
    height_mm: F32
    contact: Bool
    points_mm: F32


def pressed_object(
    sensor: SimulatedSensor,
    name: str,
    depth_mm: float,
    place_mm: tuple[float, float] = (0.0, 0.0),
    scale: float = 1.0,
) -> PressedObject:
    """Press one of Table I's objects into a sensor, enlarged as its skin and by a scale."""
    enlarged = scale * sensor.model.skin_radius_mm / 20
    press = Press(OBJECTS[name](), *place_mm, depth_mm, scale=enlarged)
    frame = sensor.frame((press,), SCENE_NOISE)
    return PressedObject(name, frame.image, frame.truth())


def calibrated(sensor: SimulatedSensor) -> Calibration:
    """Calibrate on references alone: with a press's own α, presses change nothing.

    Raises ConfigError.
    """
    model: SensorModel = sensor.model
    stated = StatedSensor(
        model.skin_radius_mm,
        model.camera_distance_mm,
        model.visible_half_angle_deg,
        "bright",
        visible_circle=model.geometry.disc,
    )
    images = [sensor.frame((), REFERENCE_NOISE + k).image for k in range(REFERENCES)]
    return calibrate(stated, images, []).calibration


class PaperMapper:
    """Makes the paper's maps of one sensor for one window and weight."""

    def __init__(self, calibration: Calibration, profile: Profile) -> None:
        self.preprocessor = Preprocessor(calibration, profile)
        self._geometry = calibration.geometry
        self._grey_mapper = GreyMapper(self.preprocessor)
        grid = self.preprocessor.grid
        self._iteration = HybridIteration((grid.rows, grid.cols))

    def maps(self, image: U8) -> GreyMaps:
        """The maps of eq. 9."""
        grey = self.preprocessor.grey(image)
        return self._grey_mapper.maps(self.preprocessor.preprocess(grey))

    def made(
        self,
        maps: GreyMaps,
        depth_mm: float,
        *,
        eq_11: bool = True,
        saturates: bool = False,
    ) -> PaperMap:
        """Carry maps on to the object's points, with α by the true depth."""
        if saturates:
            maps = replace(maps, g_d=np.maximum(maps.g_d, 0))
        unit_height = self._iteration if eq_11 else unit_by_grey
        height_mm = hybrid_depth(maps, depth_mm, unit_height).height_mm
        contact = maps.inside & (height_mm > two_means_split(height_mm[maps.inside]))
        points_mm = skin_points(height_mm, self.preprocessor.rays, self._geometry)[contact]
        return PaperMap(maps, height_mm, contact, points_mm)


def scores(
    calibration: Calibration,
    pressed: Sequence[PressedObject],
    readings: Sequence[Reading],
    *,
    eq_11: bool = True,
) -> Iterator[tuple[Reading, list[CloudScore]]]:
    """The scores of every object for every reading."""
    for profile in dict.fromkeys(reading.profile for reading in readings):
        mapper = PaperMapper(calibration, profile)
        maps = [mapper.maps(one.image) for one in pressed]
        for reading in (each for each in readings if each.profile == profile):
            found = []
            for one, each in zip(pressed, maps, strict=True):
                depth_mm, true_mm = one.truth.depth_max_mm, one.truth.points_mm
                made = mapper.made(each, depth_mm, eq_11=eq_11, saturates=reading.saturates)
                points_mm = made.points_mm
                if reading.registered and len(points_mm):
                    points_mm = points_mm + registration_mm(points_mm, true_mm)
                found.append(score_cloud(points_mm, true_mm, depth_mm))
            yield reading, found


def registration_mm(points_mm: F32, true_mm: F32) -> F32:
    """The shift (3,) in mm that moves a cloud onto the true one:
    iterated closest points, without a rotation.
    """
    thinned = points_mm[:: max(1, len(points_mm) // REGISTERED_POINTS)]
    tree, shift_mm = cKDTree(true_mm), np.zeros(3, np.float32)
    for _ in range(REGISTRATIONS):
        nearest = tree.query(thinned + shift_mm)[1]
        shift_mm = (true_mm[nearest] - thinned).mean(axis=0)
    return shift_mm
