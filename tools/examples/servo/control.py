"""The control law of both loops, which computes a velocity from an error for one number at a time."""

from __future__ import annotations

from dataclasses import dataclass

PROPORTIONAL_PER_S = 4.0
INTEGRAL_PER_S2 = 4.0
"""Without delay, both poles are at -2/s: an error decays within about a second, even if it would grow steadily."""


@dataclass(slots=True)
class Loop:
    """A proportional-integral controller with a greatest velocity, in the error's unit per second.

    `held` is the integral part of the velocity, which stays constant while the limit applies.
    """

    limit: float
    held: float = 0.0

    def velocity(self, error: float, dt_s: float) -> float:
        """Compute the velocity that reduces an error to 0; `dt_s` is the time since the last call."""
        held = self.held + INTEGRAL_PER_S2 * error * dt_s
        wanted = PROPORTIONAL_PER_S * error + held
        if abs(wanted) <= self.limit:
            self.held = held
        return max(-self.limit, min(self.limit, wanted))
