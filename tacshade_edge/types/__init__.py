"""The values that the layers pass to each other. Frozen; every array in them is read-only."""

from tacshade_edge.types.arrays import F32, F64, I32, I64, U8, U16, Bool, freeze, frozen
from tacshade_edge.types.calibration import (
    TOUCH_ARRAYS,
    Binarisation,
    Calibration,
    Fit,
    FittedNetwork,
    Polarity,
    ProfileFit,
    TouchModel,
)
from tacshade_edge.types.frame import IDENTITY_POSE, Frame, Pose
from tacshade_edge.types.geometry import Disc, Geometry
from tacshade_edge.types.reconstruction import (
    QUANTITIES,
    HeightMap,
    Need,
    ObjectCloud,
    Reconstruction,
    Slip,
    Touch,
    TouchedObject,
)

__all__ = [
    "F32",
    "F64",
    "I32",
    "I64",
    "IDENTITY_POSE",
    "QUANTITIES",
    "TOUCH_ARRAYS",
    "U8",
    "U16",
    "Binarisation",
    "Bool",
    "Calibration",
    "Disc",
    "Fit",
    "FittedNetwork",
    "Frame",
    "Geometry",
    "HeightMap",
    "Need",
    "ObjectCloud",
    "Polarity",
    "Pose",
    "ProfileFit",
    "Reconstruction",
    "Slip",
    "Touch",
    "TouchModel",
    "TouchedObject",
    "freeze",
    "frozen",
]
