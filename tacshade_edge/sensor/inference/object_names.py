"""The shipped metric of recognition (tools/training/learn_objects.py), and what names a frame's
objects with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from functools import cache, partial
from importlib import resources

import numpy as np

from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.geometry.disc import DiscRays
from tacshade_edge.sensor.geometry.disc_map import with_finite_radius
from tacshade_edge.sensor.recognition.answer import Recogniser
from tacshade_edge.sensor.recognition.metric import Metric
from tacshade_edge.sensor.recognition.naming import name_objects
from tacshade_edge.sensor.reconstruct import Namer
from tacshade_edge.types import Geometry, KnownObject, Reconstruction, TouchedObject

METRIC = "objects.npz"


@cache
def load_metric() -> Metric:
    """Load the shipped metric."""
    path = resources.files("tacshade_edge.sensor.inference") / METRIC
    with path.open("rb") as stream, np.load(stream) as file:
        values = {field.name: file[field.name] for field in fields(Metric)}
    arrays = {name: value.astype(np.float32) for name, value in values.items() if value.ndim}
    return Metric(**arrays, trust=float(values["trust"]))


def make_recogniser(known: Sequence[KnownObject]) -> Recogniser:
    """Make what answers for a profile's known objects, at least one.

    Raises ConfigError for descriptions of another size than this version's.
    """
    metric = load_metric()
    for each in known:
        if (found := each.touches.shape[1]) != len(metric.middle):
            text = f"found {found} numbers in a description, expected {len(metric.middle)}"
            raise ConfigError(f"object {each.name}: {text}; teach it again")
    return Recogniser(metric, known)


def make_namer(known: Sequence[KnownObject], rays: DiscRays, geometry: Geometry) -> Namer:
    """Make what names the objects of a profile's frames, on the grid of its height maps."""
    # A description holds the skin's radius, which is infinite for a pad.
    return partial(_named, make_recogniser(known), rays, with_finite_radius(geometry))


def _named(
    recogniser: Recogniser, rays: DiscRays, geometry: Geometry, made: Reconstruction
) -> tuple[TouchedObject, ...]:
    return name_objects(recogniser, made.height, made.cloud, made.objects, rays, geometry)
