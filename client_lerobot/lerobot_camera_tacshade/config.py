"""The settings of the camera in LeRobot's command line and files."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig

SIZE_PX = 112
_SIZE_MIN_PX, _SIZE_MAX_PX = 8, 1024


@CameraConfig.register_subclass("tacshade")
@dataclass(kw_only=True)
class TacShadeCameraConfig(CameraConfig):
    """A sensor (its ``sensor_id``) on a broker, ``HOST`` or ``HOST:PORT``.

    `username`, `password_file` (its first line): for a broker that requires a login; `ca_file`:
    certificate of the authority that signed the broker's certificate, turns TLS on; `width`,
    `height`: of the picture in px, equal, because the visible circle fills it; `fps`: LeRobot
    copies it, but the daemon determines the actual rate; `use_depth`: robots also record the height
    as a depth map.
    """

    sensor: str
    broker: str = "localhost:1883"
    username: str | None = None
    password_file: str | None = None
    ca_file: str | None = None
    width: int | None = SIZE_PX
    height: int | None = SIZE_PX
    fps: int | None = 30
    use_depth: bool = False

    def __post_init__(self) -> None:
        width = self.width
        if width != self.height or not width or not _SIZE_MIN_PX <= width <= _SIZE_MAX_PX:
            raise ValueError(
                f"found a size of {width} x {self.height}, "
                f"expected a square of {_SIZE_MIN_PX} to {_SIZE_MAX_PX}"
            )
