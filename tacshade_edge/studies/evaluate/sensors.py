"""The sensors of a study: simulated ones by name, each calibrated as a user calibrates a real one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from tacshade_edge.core.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.core.calibration.inputs import KnownPress, Sensor
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_networks, make_reconstructor
from tacshade_edge.simulator.model import SensorModel, random_model
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.script import ball_presses
from tacshade_edge.simulator.truth import SimulatedFrame, SimulatedSensor
from tacshade_edge.studies.parallel import Report, Workers, reported_map
from tacshade_edge.types import Calibration

REFERENCES, PRESSES = 8, 40
"""Default numbers of images for calibrating a sensor."""

# Each image of a sensor has its own noise seed: references, presses, scenes, frames without contact.
REFERENCE_NOISE, PRESS_NOISE, SCENE_NOISE, NULL_NOISE = 1000, 2000, 3000, 4000


class PressedSensor(Protocol):
    """A sensor that a family makes from a seed."""

    model: SensorModel

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        ...


def tacshade(seed: int | None) -> SimulatedSensor:
    """Make a sensor of the simulator's own family."""
    return SimulatedSensor(SensorModel() if seed is None else random_model(seed))


FAMILIES: dict[str, Callable[[int | None], PressedSensor]] = {"tacshade": tacshade}
"""For each family, a module-level function that makes the sensor of a seed (None: the default sensor)."""


@dataclass(frozen=True, slots=True)
class SensorName:
    """The name of a reproducible sensor: its family, and its seed or None for the family's default."""

    family: str
    seed: int | None

    @classmethod
    def parse(cls, text: str) -> SensorName:
        """Read ``default``, ``SEED``, ``FAMILY:default`` or ``FAMILY:SEED``. Raises ValueError."""
        family, colon, seed = text.strip().rpartition(":")
        family = family if colon else "tacshade"
        if family not in FAMILIES:
            raise ValueError(f"no sensor family is called {family!r}, expected one of {', '.join(FAMILIES)}")
        if seed == "default":
            return cls(family, None)
        if not (seed.isascii() and seed.isdigit() and len(seed) < 10):
            raise ValueError(f"found {seed!r}, expected a seed (a whole number) or default")
        return cls(family, int(seed))

    def __str__(self) -> str:
        """The text that `parse` reads."""
        seed = "default" if self.seed is None else str(self.seed)
        return seed if self.family == "tacshade" else f"{self.family}:{seed}"

    def make(self) -> PressedSensor:
        """Make the sensor."""
        return FAMILIES[self.family](self.seed)

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the family too, because another process may not know it."""
        return _in_family, (self.family, self.seed, FAMILIES[self.family])


def family_of(sensor: str) -> str:
    """The family of a sensor, from its name's text."""
    return sensor.rpartition(":")[0] or "tacshade"


def _in_family(family: str, seed: int | None, make: Callable[[int | None], PressedSensor]) -> SensorName:
    FAMILIES.setdefault(family, make)
    return SensorName(family, seed)


def calibrated(name: SensorName, references: int, presses: int) -> CalibrationResult:
    """Calibrate on references and known ball presses, using nothing of the model beyond its SENSOR.yaml.

    Raises ConfigError, which names the sensor, if it cannot be calibrated.
    """
    try:
        return calibrated_sensor(name.make(), name.seed or 0, references, presses)
    except ConfigError as error:
        raise ConfigError(f"sensor {name}: {error}") from None


def calibrated_sensor(sensor: PressedSensor, seed: int, references: int, presses: int) -> CalibrationResult:
    """Calibrate a sensor without a name; its presses are drawn from the seed. Raises ConfigError."""
    model = sensor.model
    stated = Sensor(model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright")
    unloaded = [sensor.frame((), REFERENCE_NOISE + k).image for k in range(references)]
    pressed = [
        KnownPress(f"press {k}", sensor.frame((p,), PRESS_NOISE + k).image, radius, p.depth_mm, p.x_mm, p.y_mm)
        for k, (p, radius) in enumerate(ball_presses(model, presses, seed))
    ]
    return calibrate(stated, unloaded, pressed, networks=load_networks())


def calibrate_sensors(
    sensors: Sequence[SensorName], references: int, presses: int, workers: Workers, report: Report
) -> list[CalibrationResult]:
    """Calibrate every sensor. Raises ConfigError (one cannot be calibrated) and DeviceError (a worker was killed)."""
    tasks = [(name, references, presses) for name in sensors]
    return list(reported_map(_calibrated, tasks, workers, report, "sensors calibrated"))


def _calibrated(task: tuple[SensorName, int, int]) -> CalibrationResult:
    return calibrated(*task)


def reconstructor(calibration: Calibration, profile: str) -> Reconstructor:
    """Make the reconstructor of a profile by name."""
    return make_reconstructor(calibration, PROFILES[profile])
