"""A robot of LeRobot with one joint that stays where it is, and cameras, depth included:
`lerobot-record` without a robot. `trial.py --lerobot-record` installs it under the name that
LeRobot looks for.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar

from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots.config import RobotConfig
from lerobot.robots.robot import Robot
from lerobot.teleoperators.config import TeleoperatorConfig
from lerobot.teleoperators.teleoperator import Teleoperator

JOINT: dict[str, Any] = {"joint.pos": 0.0}
MAX_AGE_MS = 5000  # of a picture; LeRobot's 500 are few on a busy machine


@RobotConfig.register_subclass("still")
@dataclass(kw_only=True)
class StillRobotConfig(RobotConfig):
    """Of a `StillRobot`."""

    cameras: dict[str, CameraConfig] = field(default_factory=dict)


@TeleoperatorConfig.register_subclass("still")
@dataclass(kw_only=True)
class StillTeleoperatorConfig(TeleoperatorConfig):
    """Of a `StillTeleoperator`."""


class _Still:
    """What robot and teleoperator have alike."""

    is_calibrated, is_connected = True, False
    cameras: ClassVar[dict[str, Any]] = {}
    action_features: ClassVar[dict[str, Any]] = dict.fromkeys(JOINT, float)
    feedback_features: ClassVar[dict[str, Any]] = {}

    def calibrate(self, feedback: object = None) -> None:
        """Do nothing."""

    configure = send_feedback = calibrate

    def connect(self, calibrate: bool = True) -> None:
        for camera in self.cameras.values():
            camera.connect()
        self.is_connected = True

    def disconnect(self) -> None:
        for camera in self.cameras.values():
            camera.disconnect()
        self.is_connected = False


class StillRobot(_Still, Robot):
    config_class, name = StillRobotConfig, "still"

    def __init__(self, config: StillRobotConfig) -> None:
        super().__init__(config)
        self.cameras = make_cameras_from_configs(config.cameras)

    @property
    def observation_features(self) -> dict[str, Any]:
        shapes = {name: (one.height, one.width, 3) for name, one in self.cameras.items()}
        depths = {
            f"{name}_depth": (one.height, one.width, 1)
            for name, one in self.cameras.items()
            if one.use_depth
        }
        return self.action_features | shapes | depths

    def get_observation(self) -> dict[str, Any]:
        pictures = {name: one.read_latest(MAX_AGE_MS) for name, one in self.cameras.items()}
        deep = {name: one for name, one in self.cameras.items() if one.use_depth}
        return (
            JOINT
            | pictures
            | {f"{name}_depth": one.read_latest_depth(MAX_AGE_MS) for name, one in deep.items()}
        )

    def send_action(self, action: dict[str, Any]) -> dict[str, Any]:
        return action


class StillTeleoperator(_Still, Teleoperator):
    config_class, name = StillTeleoperatorConfig, "still"

    def get_action(self) -> dict[str, Any]:
        return dict(JOINT)
