"""The demo's calibration: the real `calibrate` on references and ball presses of the simulated sensor."""

from __future__ import annotations

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import KnownPress, Sensor
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.script import ball_presses
from tacshade_edge.simulator.truth import SimulatedSensor
from tacshade_edge.types import Calibration

REFERENCES, PRESSES = 5, 20


def make_calibration() -> Calibration:
    """Calibrate the demo's simulated sensor; this takes one or two seconds."""
    model = SensorModel()
    simulated = SimulatedSensor(model)
    sensor = Sensor(model.skin_radius_mm, model.camera_distance_mm, model.visible_half_angle_deg, "bright")
    references = [simulated.frame(noise_seed=seed).image for seed in range(REFERENCES)]
    presses = []
    for k, (press, radius_mm) in enumerate(ball_presses(model, PRESSES)):
        image = simulated.frame([press], noise_seed=REFERENCES + k).image
        presses.append(KnownPress(f"press {k}", image, radius_mm, press.depth_mm, press.x_mm, press.y_mm))
    return calibrate(sensor, references, presses).calibration
