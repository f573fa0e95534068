"""TacShade tactile sensors as cameras of LeRobot; importing it registers the type ``tacshade``."""

from .camera import TacShadeCamera
from .colours import STEP_MM, to_mm, to_rgb
from .config import TacShadeCameraConfig

__all__ = ["STEP_MM", "TacShadeCamera", "TacShadeCameraConfig", "to_mm", "to_rgb"]
