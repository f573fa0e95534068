"""What `teach` and `recognise` share: descriptions of the touches in images."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import DecodeError
from tacshade_edge.files.images import read_image
from tacshade_edge.quoting import encodable
from tacshade_edge.reasons import text_of
from tacshade_edge.sensor.geometry.disc_map import with_finite_radius
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.recognition.naming import describe_touch
from tacshade_edge.types import F32, Calibration, Frame, Reconstruction

TOO_LIGHT = "found no touch that is firm enough to show a form"


@dataclass(frozen=True, slots=True)
class TouchedImage:
    """An image, each profile's reconstruction, and its description of the touch; None if it shows
    none.
    """

    path: Path
    results: dict[str, Reconstruction]
    descriptions: dict[str, F32 | None]

    @property
    def name(self) -> str:
        """The image's path, for people and JSON."""
        return encodable(str(self.path))


def touched_images(
    calibration: Calibration, profiles: Sequence[str], images: Sequence[Path], progress: Progress
) -> Iterator[TouchedImage | None]:
    """Yield each image, or None after a line that says why it is unusable."""
    made = {name: make_reconstructor(calibration, PROFILES[name]) for name in profiles}
    for index, path in enumerate(images):
        progress("images", index, len(images))
        try:
            image = read_image(path)
        except DecodeError as error:
            # The other images may still be enough to teach or to name the object.
            progress.warn(error)
            yield None
            continue
        frame = Frame(seq=index, t_ns=0, wall_ns=0, image=image)
        results = {name: each.step(frame) for name, each in made.items()}
        if wrong := next((each for each in results.values() if not each.valid), None):
            progress.warn(f"{path}: invalid: {text_of(wrong.reason)}")
            yield None
            continue
        geometry = with_finite_radius(calibration.geometry)
        descriptions = {
            name: describe_touch(results[name].height, each.rays, geometry)
            if results[name].contact
            else None
            for name, each in made.items()
        }
        yield TouchedImage(path, results, descriptions)
    progress.end()


def without_names(calibration: Calibration) -> Calibration:
    """The calibration as if nothing was taught."""
    return replace(calibration, known={})
