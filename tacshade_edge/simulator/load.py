"""The load between an object and the skin: pressure along the radius, traction along the skin, summed over a contact.

Loads are in skin units, p / kn and q / kt in mm, so that a load is in mm³. The stiffnesses kn along the radius and kt
along the skin are left open: `SensorModel.coulomb` is μ kn / kt, and callers that add both loads state μ.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tacshade_edge.types import F64, frozen


@frozen
class Load:
    """The load of one press: ∫ p / kn and ∫ |q| / kt over its contact (the latter also of a twist, whose tractions
    cancel in `pull_mm3`); the force of the pressure on the object, through O, and of the traction, and the latter's
    torque about O, in the sensor frame; `surplus`, the part of its drag and twist that the object could reverse without
    sticking anywhere (0 if it sticks).
    """

    normal_mm3: float
    shear_mm3: float
    push_mm3: F64
    pull_mm3: F64
    torque_mm4: F64
    surplus: float

    def turned(self, rotation: F64) -> Load:
        """The same load along other axes, turned by a rotation (3, 3)."""
        push, pull, torque = (rotation @ each for each in (self.push_mm3, self.pull_mm3, self.torque_mm4))
        return replace(self, push_mm3=push, pull_mm3=pull, torque_mm4=torque)

    def margin(self, coulomb: float) -> float:
        """1 minus the used share of Coulomb's limit: 1 has no load along the skin, 0 slides."""
        most = coulomb * self.normal_mm3
        return 1 - min(self.shear_mm3 / most, 1.0) if most > 0 else 0.0


def summed(direction: F64, points_mm: F64, pressure_mm: F64, traction_mm: F64, area_mm2: float, surplus: float) -> Load:
    """Sum the loads of a contact's nodes, each of an area: unit vectors from O and places (N, 3), p / kn (N,), and q /
    kt (N, 2) of the skin along the chart's axes; a length in the chart is taken as one on the skin.
    """
    # Unit tangents of the chart's axes.
    over = direction[:, :2] / (1 + direction[:, 2:])
    zero, one = np.zeros(len(direction)), np.ones(len(direction))
    along_x = np.stack((one, zero, zero), axis=1) - direction[:, :1] * np.column_stack((over, one))
    along_y = np.stack((zero, one, zero), axis=1) - direction[:, 1:2] * np.column_stack((over, one))
    pull = -area_mm2 * (traction_mm[:, :1] * along_x + traction_mm[:, 1:] * along_y)
    return Load(
        normal_mm3=area_mm2 * float(pressure_mm.sum()),
        shear_mm3=area_mm2 * float(np.linalg.norm(traction_mm, axis=1).sum()),
        push_mm3=area_mm2 * (pressure_mm[:, None] * direction).sum(axis=0),
        pull_mm3=pull.sum(axis=0),
        torque_mm4=np.cross(points_mm, pull).sum(axis=0),
        surplus=surplus,
    )
