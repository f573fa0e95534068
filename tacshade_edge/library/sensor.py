"""A calibrated sensor: images in, results out."""

from __future__ import annotations

import os
import threading
from typing import Final, get_args

import numpy as np

from tacshade_edge.calibration import loading
from tacshade_edge.errors import ConfigError
from tacshade_edge.files.images import read_image
from tacshade_edge.library.arguments import path_of, wrong
from tacshade_edge.library.result import Result, result_of
from tacshade_edge.sensor.contact.tracking import ContactTracker
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, NETWORK, PROFILES, Outline, profile_with
from tacshade_edge.sensor.reconstruct import step_and_track
from tacshade_edge.types import U8, Calibration, Frame, Geometry

_EXPECTED: Final = "a path, or uint8 (rows, cols) or (rows, cols, 3), blue first"


def load(
    calibration: str | os.PathLike[str], *, profile: str = DEFAULT, outline: Outline = NETWORK
) -> Sensor:
    """Load a sensor from its calibration, the file that ``tacshade-edge calibrate`` wrote.

    Parameters
    ----------
    calibration : path
        Never written to: an older version's file is recalibrated from its images on each load,
        which the log reports.
    profile : str
        ``fast``, ``balanced``, ``accurate`` or ``paper``.
    outline : str
        What separates the contact from the other skin: ``network``, or ``kmeans`` for two means of
        the heights as in section V-A of the paper, which ``paper`` always uses.

    Returns
    -------
    Sensor
        Takes images of the size that the calibration was made with.

    Raises
    ------
    ConfigError
        The calibration cannot be used, or there is no such profile or outline.
    """
    # Not stored: a daemon may be using this file, which belongs to its service.
    known = loading.load(path_of("calibration", calibration), store=False)
    return Sensor(known, profile, outline)


class Sensor:
    """A calibrated sensor with one profile; only one thread may use it at a time.

    Attributes
    ----------
    profile : str
        ``fast``, ``balanced``, ``accurate`` or ``paper``.
    geometry : Geometry
        Skin, camera and visible circle.
    image_size_px : (int, int)
        Rows and columns of its images.
    """

    def __init__(self, calibration: Calibration, profile: str, outline: Outline = NETWORK) -> None:
        if not isinstance(calibration, Calibration):
            raise wrong("calibration", calibration, "what tacshade_edge.load reads: load(path)")
        if not isinstance(profile, str) or profile not in PROFILES:
            raise wrong("profile", profile, f"one of {', '.join(sorted(PROFILES))}")
        if outline not in get_args(Outline):
            raise wrong("outline", outline, f"one of {', '.join(get_args(Outline))}")
        self._made_of = calibration, profile, outline
        self._reconstructor = make_reconstructor(calibration, profile_with(profile, outline))
        # Never waited for: the reconstructor's scratch buffers hold one frame, and a thread that
        # waits here would hide that it needs a sensor of its own.
        self._in_use = threading.Lock()
        self.profile = profile
        self.geometry: Geometry = calibration.geometry
        self.image_size_px = (calibration.image_height_px, calibration.image_width_px)

    def __reduce__(self) -> tuple[type[Sensor], tuple[Calibration, str, Outline]]:
        """Pickle it as what it was made of; what it has tracked stays behind."""
        return type(self), self._made_of

    def __repr__(self) -> str:
        """The sensor in a line, for people."""
        rows, cols = self.image_size_px
        known = self.geometry
        form = f"of radius {known.skin_radius_mm:g} mm"
        if known.skin == "pad":
            form = f"with a pad of radius {known.visible_radius_mm:g} mm"
        return f"<Sensor {form}, {self.profile}, images of {cols}x{rows} px>"

    def reconstruct(self, image: str | os.PathLike[str] | U8) -> Result:
        """Reconstruct a single image; an unusable image gives a result that is not `valid`.

        Parameters
        ----------
        image : path, or uint8 (rows, cols) grey or (rows, cols, 3) BGR
            The camera's image, unprocessed; never modified. Its size is `image_size_px`; another
            size gives a result that is not `valid`.

        Returns
        -------
        Result
            Its arrays are its own, read-only; lengths in mm. `seq`, `t_ns` and `wall_ns` are 0.

        Raises
        ------
        DecodeError
            The file cannot be read.
        ConfigError
            The argument is none of these, or another thread is using the sensor.
        """
        if isinstance(image, np.ndarray):
            # Not only `ndim`: two or four channels have no order that we could know.
            match image.shape:
                case (_, _) | (_, _, 3):
                    shaped = True
                case _:
                    shaped = False
            if image.dtype != np.uint8 or not shaped or image.size == 0:
                raise ConfigError(f"image: found {image.dtype} {image.shape}, expected {_EXPECTED}")
            # A view such as image[::2] has gaps, and the steps that follow read rows without any.
            pixels: U8 = np.ascontiguousarray(image)
        elif isinstance(image, str | os.PathLike):
            pixels = read_image(path_of("image", image))
        else:
            raise wrong("image", image, _EXPECTED)
        return self.step(Frame(0, 0, 0, pixels), None)

    def step(self, frame: Frame, tracker: ContactTracker | None) -> Result:
        """Reconstruct a frame of a stream and track its objects; for the library's internal use.

        Raises ConfigError.
        """
        if not self._in_use.acquire(blocking=False):
            raise ConfigError(
                "sensor: found two threads using one sensor, expected one thread; load a sensor "
                "in each thread"
            )
        try:
            made = step_and_track(self._reconstructor, tracker, frame)
        finally:
            self._in_use.release()
        assert made is not None
        # Always an array here: None is of results from a broker, which does not send it.
        untrusted = (
            np.zeros(made.height.contact.shape, np.bool_)
            if made.untrusted is None
            else made.untrusted
        )
        return result_of(made, self.geometry, frame.pose, untrusted)
