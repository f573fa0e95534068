"""The control law of both loops: a velocity from an error, one number at a time."""

from __future__ import annotations

from dataclasses import dataclass

PROPORTIONAL_PER_S = 4.0
INTEGRAL_PER_S2 = 4.0
"""Without delay both poles are at 2/s: an error is gone within a second, one that grows steadily too."""


@dataclass(slots=True)
class Loop:
    """Velocity by proportion and integral, limited; the integral rests while the limit holds.

    Attributes
    ----------
    limit : float
        Greatest velocity, in the error's unit per second.
    held : float
        The integral's part of the velocity.
    """

    limit: float
    held: float = 0.0

    def velocity(self, error: float, dt_s: float) -> float:
        """What takes an error to 0; `dt_s` is since the last call."""
        held = self.held + INTEGRAL_PER_S2 * error * dt_s
        wanted = PROPORTIONAL_PER_S * error + held
        if abs(wanted) <= self.limit:
            self.held = held
        return max(-self.limit, min(self.limit, wanted))
