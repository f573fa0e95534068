"""The values that rooms pass to each other. Frozen; every array in them is read-only.

Threads: none.
Other rooms use: `calibration`, and the names below.
"""

from tacshade_edge.types.calibration import (
    TOUCH_ARRAYS,
    Binarisation,
    Calibration,
    Fit,
    FittedNetwork,
    Polarity,
    ProfileFit,
    RestLimits,
    TouchModel,
)
from tacshade_edge.types.geometry import (
    F32,
    F64,
    I32,
    I64,
    IDENTITY_POSE,
    U8,
    U16,
    Bool,
    Disc,
    Frame,
    Geometry,
    Pose,
    Skin,
    freeze,
    frozen,
)
from tacshade_edge.types.known_objects import KnownObject
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
    "U8",
    "U16",
    "Bool",
    "Disc",
    "Frame",
    "Geometry",
    "Pose",
    "Skin",
]
__all__ += [
    "Binarisation",
    "Calibration",
    "Fit",
    "FittedNetwork",
    "Polarity",
    "ProfileFit",
    "RestLimits",
    "freeze",
    "frozen",
]
__all__ += [
    "QUANTITIES",
    "TOUCH_ARRAYS",
    "HeightMap",
    "KnownObject",
    "Need",
    "ObjectCloud",
    "Reconstruction",
    "Slip",
    "TouchModel",
]
__all__ += ["Touch", "TouchedObject"]
