"""Keep the inputs of a calibration, to repeat it when the program has changed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import Inputs, KnownPress, Sensor
from tacshade_edge.core.calibration.reference.references import rezero
from tacshade_edge.core.depth import Network
from tacshade_edge.core.image.greyscale import to_grey
from tacshade_edge.types import U8, Calibration


def inputs_of(sensor: Sensor, references: Sequence[U8], presses: Sequence[KnownPress]) -> Inputs:
    """Keep the inputs of `calibrate`, the images in grey, which is all that it uses."""
    greys = tuple(to_grey(image) for image in references)
    return Inputs(sensor, greys, tuple(replace(press, image=to_grey(press.image)) for press in presses))


def with_new_reference(inputs: Inputs, images: Sequence[U8]) -> Inputs:
    """The same inputs after `rezero` with these images."""
    return replace(inputs, renewed=tuple(to_grey(image) for image in images))


def make_again(inputs: Inputs, networks: Mapping[str, Network]) -> Calibration:
    """Repeat a calibration with the present program. Raises ConfigError if that can no longer use these inputs."""
    # The first calibration already warned of a loaded reference, or rejected it.
    made = calibrate(inputs.sensor, inputs.references, inputs.presses, True, networks).calibration
    return rezero(made, inputs.renewed, True) if inputs.renewed else made
