"""Parse the serial output of a scale: a number and its unit, with any text around them."""

from __future__ import annotations

import re
from typing import Final

STANDARD_GRAVITY_M_S2: Final = 9.80665
_POUND_KG: Final = 0.45359237
_NEWTONS: Final = {
    **{"n": 1.0, "mn": 1e-3, "kn": 1e3},
    **{
        name: STANDARD_GRAVITY_M_S2 * kg
        for name, kg in (("mg", 1e-6), ("g", 1e-3), ("kg", 1.0), ("lb", _POUND_KG), ("oz", _POUND_KG / 16))
    },
    **{
        name: STANDARD_GRAVITY_M_S2 * kg
        for name, kg in (("gf", 1e-3), ("kgf", 1.0), ("lbf", _POUND_KG), ("ozf", _POUND_KG / 16))
    },
}
UNITS: Final = "g, kg, mg, N, mN, kN, lb, oz"
_READING = re.compile(r"([+-]?) *(\d+(?:[.,]\d+)?|[.,]\d+) *([a-z]+)", re.IGNORECASE)


def parse_reading(line: bytes) -> float | None:
    """The force in N that a line reports, a mass as its weight; None if it has no number with a known unit.

    ``ST,GS,+  0.123 kg``, ``-12,5g`` and ``1.2 N`` are readings.
    """
    for sign, digits, unit in _READING.findall(line.decode("ascii", "replace")):
        if (newtons := _NEWTONS.get(unit.lower())) is not None:
            return (-1 if sign == "-" else 1) * float(digits.replace(",", ".")) * newtons
    return None
