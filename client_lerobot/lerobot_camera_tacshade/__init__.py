"""TacShade tactile sensors as cameras of LeRobot; importing it registers the type ``tacshade``."""

from .camera import TacShadeCamera
from .colours import STEP_MM, to_mm, to_rgb
from .config import TacShadeCameraConfig
from .pictures import TACTILE, tactile_feature

__all__ = [
    "STEP_MM",
    "TACTILE",
    "TacShadeCamera",
    "TacShadeCameraConfig",
    "tactile_feature",
    "to_mm",
    "to_rgb",
]
