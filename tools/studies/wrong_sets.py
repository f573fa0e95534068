"""A good set of references and presses, and every error that a user may make in one.

`tools.studies.calibration` counts which of them `calibrate` finds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from support import bad_pictures
from tacshade_edge.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.calibration.inputs import KnownPress, StatedSensor
from tacshade_edge.calibration.observation import PressObservation, first_touch_mm
from tacshade_edge.calibration.presses.press_check import PressCheck
from tacshade_edge.calibration.presses.press_selection import outliers
from tacshade_edge.calibration.quality import GRADED_PROFILE
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.calibration.sentences import sentence
from tacshade_edge.cli.shared.finding_options import WITH_OPTIONS
from tacshade_edge.errors import ConfigError
from tacshade_edge.lab.simulator import camera_faults
from tacshade_edge.lab.simulator.press import Press, ball
from tacshade_edge.lab.simulator.script import ball_presses
from tacshade_edge.lab.simulator.sensor_model import SensorModel, random_model
from tacshade_edge.lab.simulator.truth import SimulatedSensor
from tacshade_edge.sensor.geometry.disc_map import skin_scale
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.inference.network import load_networks
from tacshade_edge.types import U8

REFERENCES, PRESSES = 5, 24


@dataclass(frozen=True, slots=True)
class Set:
    """The references and presses that a user brings."""

    model: SensorModel
    simulated: SimulatedSensor
    sensor: StatedSensor
    references: list[U8]
    presses: list[KnownPress]

    @property
    def scale(self) -> float:
        """The factor on lengths on the nominal skin."""
        return skin_scale(self.model.geometry)

    def loaded(self, depth_mm: float, x_mm: float, y_mm: float, noise_seed: int) -> U8:
        """An image of the skin under a ball; mm on the nominal skin."""
        press = Press(
            ball(6.0 * self.scale), x_mm * self.scale, y_mm * self.scale, depth_mm * self.scale
        )
        return to_grey(self.simulated.frame((press,), noise_seed).image)

    def calibrate(
        self, references: list[U8] | None = None, presses: list[KnownPress] | None = None
    ) -> CalibrationResult:
        """Calibrate on this set, with other references or presses if given."""
        taken = self.presses if presses is None else presses
        return calibrate(
            self.sensor, references or self.references, taken, networks=load_networks()
        )


def good_set(seed: int, height_px: int) -> Set:
    """A good set of a random sensor."""
    model = random_model(seed, height_px, height_px * 4 // 3)
    simulated = SimulatedSensor(model)
    sensor = StatedSensor(
        model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright"
    )
    presses = [
        KnownPress(
            f"press {k}",
            to_grey(simulated.frame([p], 2000 + k).image),
            r,
            p.depth_mm,
            p.x_mm,
            p.y_mm,
        )
        for k, (p, r) in enumerate(ball_presses(model, PRESSES, seed))
    ]
    references = [to_grey(simulated.frame((), 1000 + k).image) for k in range(REFERENCES)]
    return Set(model, simulated, sensor, references, presses)


def answer(made: Callable[[], CalibrationResult]) -> str:
    """All warnings and advice for a set."""
    try:
        result = made()
    except ConfigError as error:
        return f"refused: {error}"
    said = (*result.warnings, result.quality.line, *result.quality.advice)
    return "\n".join(sentence(one, WITH_OPTIONS) for one in said)


def shifted(image: U8, px: float) -> U8:
    """Move an image to the right."""
    matrix = np.array([[1, 0, px], [0, 1, 0]], dtype=np.float64)
    size = (image.shape[1], image.shape[0])
    return np.asarray(
        cv2.warpAffine(image, matrix, size, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def uneven(image: U8, part: float) -> U8:
    """Darken one side, as if one LED of a ring had aged."""
    ramp = 1 - part * np.linspace(0, 1, image.shape[1], dtype=np.float32)[None, :]
    return np.asarray(np.rint(image * ramp), np.uint8)


def wrong_presses(given: Set) -> Iterator[tuple[str, bool]]:
    """What is wrong with one press, and whether it is found; each press in turn."""
    unloaded, scale = given.calibrate(presses=[]).calibration, given.scale
    check, geometry = PressCheck(unloaded, load_networks()[GRADED_PROFILE]), unloaded.geometry
    looks = [check.look(press.image) for press in given.presses]
    grey = [
        check.observe(look.maps, press) for look, press in zip(looks, given.presses, strict=True)
    ]
    observed = [
        check.see(look, each, press)
        for look, each, press in zip(looks, grey, given.presses, strict=True)
    ]
    changes: dict[str, Callable[[KnownPress], KnownPress]] = {
        f"one depth {off:+.1f} mm off": lambda p, off=off: replace(
            p, depth_mm=p.depth_mm + off * scale
        )
        for off in (-1.5, 1.0, 1.5, 2.0, 2.5)
    }
    changes |= {
        f"one ball radius times {factor}": lambda p, factor=factor: replace(
            p, radius_mm=p.radius_mm * factor
        )
        for factor in (0.5, 0.67, 1.5, 2.0)
    }
    changes |= {
        f"one place {off} mm off": lambda p, off=off: replace(p, x_mm=(p.x_mm or 0.0) + off * scale)
        for off in (2, 3, 4, 5)
    }
    changes["x and y swapped at one press"] = lambda p: replace(p, x_mm=p.y_mm, y_mm=p.x_mm)
    for label, change in changes.items():
        for k, press in enumerate(given.presses):
            wrong = change(press)
            if wrong.depth_mm <= 0.2 * scale:
                continue
            stated = replace(
                grey[k],
                depth_mm=wrong.depth_mm,
                radius_mm=wrong.radius_mm,
                x_mm=wrong.x_mm,
                y_mm=wrong.y_mm,
            )
            found = outliers(
                [*observed[:k], check.see(looks[k], stated, wrong), *observed[k + 1 :]],
                geometry,
            )
            yield label, k in found


Wrong = Iterator[tuple[str, str, str]]
"""The error, the text that the answer must contain, and the answer."""


def wrong_sets(given: Set, rng: np.random.Generator) -> Wrong:
    """Every error in a set, one at a time."""
    press = given.presses[int(rng.integers(4, len(given.presses) - 2))]
    yield from other_rows(given, rng)
    yield from other_depths(given)
    yield from other_places(given)
    yield from too_much_alike(given)
    yield from moved_cameras(given, press)
    yield from other_light(given, press)
    yield from pressed_references(given)


def with_presses(given: Set, presses: list[KnownPress]) -> str:
    """The answer to a set with other presses."""
    return answer(lambda: given.calibrate(presses=presses))


def with_references(given: Set, references: list[U8]) -> str:
    """The answer to other references alone."""
    return answer(lambda: given.calibrate(references, []))


def other_rows(given: Set, rng: np.random.Generator) -> Wrong:
    """Images with the depths of other rows, with all their values, and with these but no places."""
    presses = given.presses
    shuffled = rng.permutation([p.depth_mm for p in presses])
    swapped = [replace(p, depth_mm=float(d)) for p, d in zip(presses, shuffled, strict=True)]
    yield "all depths shuffled", "refused|poor", with_presses(given, swapped)
    count = len(presses)
    numbers = np.arange(count)
    for label, wanted, order in (
        ("the row before", "the row before?", np.roll(numbers, 1)),
        ("the row after", "the row after?", np.roll(numbers, -1)),
        ("rows in the opposite order", "the opposite order?", numbers[::-1]),
        ("rows in another order", "another order?", rng.permutation(count)),
    ):
        values = [presses[k] for k in order]
        moved = [
            replace(other, image=one.image, name=one.name)
            for one, other in zip(presses, values, strict=True)
        ]
        yield f"values of {label}", wanted, with_presses(given, moved)
        bare = [replace(one, x_mm=None, y_mm=None) for one in moved]
        yield f"values of {label}, without places", wanted, with_presses(given, bare)


def other_depths(given: Set) -> Wrong:
    """Depths in other units, or measured from elsewhere."""
    presses, scale = given.presses, given.scale
    for unit, factor in (("cm", 0.1), ("inches", 1 / 25.4), ("m", 0.001)):
        made = [replace(p, depth_mm=p.depth_mm * factor) for p in presses]
        yield f"depths in {unit}", f"depths in {unit}?", with_presses(given, made)
    touch = first_touch_mm(
        [PressObservation("", 1, 1, 1, 0, 0, p.radius_mm, 0, p.x_mm, p.y_mm) for p in presses],
        given.model.geometry,
    )
    travel = [
        replace(p, depth_mm=p.depth_mm - float(t)) for p, t in zip(presses, touch, strict=True)
    ]
    label, wanted = "depths are travel from first touch", "travel from first touch"
    yield label, wanted, with_presses(given, travel)
    for off in (-0.5, 0.5, 1.0):
        made = [replace(p, depth_mm=p.depth_mm + off * scale) for p in presses]
        size, more = ("small", "more") if off < 0 else ("great", "less")
        yield (
            f"all depths {abs(off)} mm too {size}",
            f"mm {more}: check where depth is zero",
            with_presses(given, [p for p in made if p.depth_mm > 0]),
        )


def other_places(given: Set) -> Wrong:
    """Places with other axes."""
    swapped = [replace(p, x_mm=p.y_mm, y_mm=p.x_mm) for p in given.presses]
    yield "x and y swapped", "swapped", with_presses(given, swapped)
    mirrored = [replace(p, y_mm=-(p.y_mm or 0)) for p in given.presses]
    yield "y with the other sign", "opposite sign", with_presses(given, mirrored)


def too_much_alike(given: Set) -> Wrong:
    """Presses of one place, depth or radius."""
    presses = given.presses
    near = sorted(presses, key=lambda p: (p.x_mm or 0) ** 2 + (p.y_mm or 0) ** 2)[:8]
    yield "8 presses in the middle", "close together", with_presses(given, near)
    half = [p for p in presses if (p.x_mm or 0) > -1]
    yield "half the disc", "no press lies|close together", with_presses(given, half)
    alike = sorted(presses, key=lambda p: p.depth_mm)[-10:]
    yield "10 presses of like depth", "mm deep: add some", with_presses(given, alike)
    alike = sorted(presses, key=lambda p: p.radius_mm)[8:16]
    yield "8 presses of like radius", "all presses use balls", with_presses(given, alike)


def with_image(given: Set, press: KnownPress, change: Callable[[U8], U8]) -> str:
    """The answer to a set in which the picture of one press is another."""
    changed = replace(press, image=change(press.image))
    return with_presses(given, [changed if p is press else p for p in given.presses])


def moved_cameras(given: Set, press: KnownPress) -> Wrong:
    """A camera that moved for one press, or after the first reference."""
    for px in (0.5, 1.0, 2.0, 6.0):
        yield (
            f"camera {px} px away at one press",
            f"{press.name}: the image moved",
            with_image(given, press, lambda image, px=px: shifted(image, px)),
        )
    for px in (1.0, 2.0, 6.0):
        first, *others = given.references
        views = [first, *(shifted(image, px) for image in others)]
        label = f"camera {px} px away after the first reference"
        yield label, "moved", with_references(given, views)


def other_light(given: Set, press: KnownPress) -> Wrong:
    """Other light, or another focus, at one press."""
    for label, change in {
        "light x 0.75": lambda image: camera_faults.gain(image, 0.75),
        "light x 0.9 (compensated)": lambda image: camera_faults.gain(image, 0.9),
        "one side 40 % darker": lambda image: uneven(image, 0.4),
        "blurred by 1.5 px": lambda image: bad_pictures.defocus(image, 1.5),
    }.items():
        yield f"{label} at one press", f"{press.name}:", with_image(given, press, change)


def pressed_references(given: Set) -> Wrong:
    """References of a skin under a load."""
    for depth in (1.0, 2.0):
        images = [*given.references[1:], given.loaded(depth, 3, 2, 5)]
        label = f"one reference of 5 under {depth} mm"
        yield label, "pressed|load", with_references(given, images)
    for depth in (1.0, 2.0, 3.0):
        for place, x_mm in (("in the middle", 0.0), ("5 mm beside", 5.0)):
            images = [given.loaded(depth, x_mm, 0, k) for k in range(3)]
            label = f"all references under {depth} mm {place}"
            yield label, "seems pressed", with_references(given, images)


def rezeros(given: Set, result: CalibrationResult) -> Wrong:
    """New references that must be taken, and some that must not."""

    def said(images: list[U8]) -> str:
        try:
            rezero(result.calibration, images)
        except ConfigError as error:
            return f"refused: {error}"
        return "taken"

    free = [to_grey(given.simulated.frame((), 3000 + k).image) for k in range(5)]
    yield "rezero: untouched", "taken", said(free)
    yield "rezero: light x 0.7", "taken", said([camera_faults.gain(image, 0.7) for image in free])
    yield "rezero: 2 px away", "taken", said([shifted(image, 2) for image in free])
    yield "rezero: 6 px away", "refused", said([shifted(image, 6) for image in free])
    yield "rezero: light x 0.4", "refused", said([camera_faults.gain(image, 0.4) for image in free])
    yield (
        "rezero: blurred by 3 px",
        "refused",
        said([bad_pictures.defocus(image, 3) for image in free]),
    )
    for depth in (1.0, 2.0, 3.0):
        yield f"rezero: under {depth} mm", "refused", said([given.loaded(depth, 3, 2, 5)] * 3)
