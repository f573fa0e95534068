"""Name the objects of a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from tacshade_edge.sensor.geometry.disc import DiscRays, Grid, labels_by_cell
from tacshade_edge.sensor.recognition.answer import UNKNOWN, Answer, Recogniser
from tacshade_edge.sensor.recognition.description import describe
from tacshade_edge.types import F32, Bool, Geometry, HeightMap, ObjectCloud, TouchedObject

NAMED_MAX = 8  # of a frame's objects, the largest; smaller ones are not named
LEAST_DEPTH_PART = 0.04  # of the skin's radius: lighter touches show no form


def describe_touch(height: HeightMap, rays: DiscRays, geometry: Geometry) -> F32 | None:
    """Describe all that touches in a map, as one thing; None where it is too light or too small."""
    return _described(height, height.contact, rays, geometry)


def name_objects(
    recogniser: Recogniser,
    height: HeightMap,
    cloud: ObjectCloud,
    objects: Sequence[TouchedObject],
    rays: DiscRays,
    geometry: Geometry,
) -> tuple[TouchedObject, ...]:
    """Give the objects (at least one) their names. Parts of one thing, such as the studs of a
    brick, take its name where they are more surely that thing than each is a thing of its own.
    """
    whole = _answer(recogniser, describe_touch(height, rays, geometry))
    if len(objects) == 1:
        return (replace(objects[0], name=whole.name, probability=whole.probability),)
    rows, cols = height.height_mm.shape
    grid = Grid(rows, cols, height.row0, height.col0, height.step_px)
    # A result has no image of labels: where each object lies follows from its points.
    labels = labels_by_cell(cloud.points_mm, cloud.labels, grid, geometry)
    answers = [
        _answer(recogniser, _described(height, labels == each.label, rays, geometry))
        for each in objects[:NAMED_MAX]
    ]
    # A brick is more surely a brick than each of its studs is anything.
    surest = max(one.probability or 0.0 for one in answers)
    if (whole.probability or 0.0) > surest:
        answers = [whole] * len(objects)
    answers += [UNKNOWN] * (len(objects) - len(answers))
    return tuple(
        replace(each, name=answer.name, probability=answer.probability)
        for each, answer in zip(objects, answers, strict=True)
    )


def _described(height: HeightMap, touched: Bool, rays: DiscRays, geometry: Geometry) -> F32 | None:
    depths = height.height_mm[touched]
    if not depths.size or depths.max() < LEAST_DEPTH_PART * geometry.skin_radius_mm:
        return None
    return describe(height.height_mm, touched, rays, geometry)


def _answer(recogniser: Recogniser, description: F32 | None) -> Answer:
    return UNKNOWN if description is None else recogniser.answer(description[None])
