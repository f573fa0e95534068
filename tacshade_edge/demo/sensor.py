"""The demo's calibration: the real `calibrate` on references and ball presses of the simulated sensor."""

from __future__ import annotations

from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import KnownPress, Sensor
from tacshade_edge.simulator.calibration_set import ball_presses
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.types import Calibration

REFERENCES, PRESSES = 5, 20


def make_calibration() -> Calibration:
    """Calibrate the demo's simulated sensor; this takes one or two seconds."""
    model = SensorModel()
    simulated = SimulatedSensor(model)
    sensor = Sensor(
        skin_radius_mm=model.skin_radius_mm,
        camera_distance_mm=model.camera_distance_mm,
        visible_half_angle_deg=model.visible_half_angle_deg,
        polarity="bright",
    )
    references = [simulated.frame(noise_seed=seed).image for seed in range(REFERENCES)]
    presses = [
        KnownPress(
            name=f"press {number}",
            image=simulated.frame([press], noise_seed=REFERENCES + number).image,
            radius_mm=radius_mm,
            depth_mm=press.depth_mm,
            x_mm=press.x_mm,
            y_mm=press.y_mm,
        )
        for number, (press, radius_mm) in enumerate(ball_presses(model, PRESSES))
    ]
    return calibrate(sensor, references, presses).calibration
