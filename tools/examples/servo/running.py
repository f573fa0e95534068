"""The part that both loops share: read results and send velocities until Ctrl-C, a set time,
or a lost sensor.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import tacshade_edge as ts
from tools.examples.servo.robot import STOP_S, Robot

Velocity = tuple[float, float, float, float, float, float]
"""(vx, vy, vz, wx, wy, wz): mm/s and °/s of the tip, along and about the sensor's axes."""


def options(doc: str | None) -> argparse.ArgumentParser:
    """Make the parser for the arguments of both loops."""
    parser = argparse.ArgumentParser(description=(doc or "").splitlines()[0])
    parser.add_argument("broker", help="HOST or HOST:PORT")
    parser.add_argument("sensor", help="its sensor_id")
    parser.add_argument(
        "--robot", required=True, metavar="HOST:PORT", help="that takes velocities (robot.py)"
    )
    parser.add_argument("--depth-mm", type=float, default=1.5, help="to keep")
    parser.add_argument("--speed-mm-s", type=float, default=10.0, help="along the sensor's x")
    parser.add_argument("--seconds", type=float, default=float("inf"))
    return parser


def run(
    args: argparse.Namespace,
    names: Sequence[str],
    velocity: Callable[[Mapping[str, float], float], Velocity],
) -> int:
    """Call `velocity` with each touch and the seconds since the last one,
    and send the result to the robot.
    """
    ages_ms: list[float] = []
    first_ns = last_ns = 0
    try:
        with ts.listen(args.broker, args.sensor) as results, Robot(args.robot) as robot:
            for r in results:
                age_ms = (time.time_ns() - r.wall_ns) / 1e6
                if (touch := numbers(r, names)) is None or age_ms > 1e3 * STOP_S:
                    continue  # `Robot` stops automatically if this lasts
                first_ns = first_ns or r.t_ns
                dt_s = min((r.t_ns - (last_ns or r.t_ns)) / 1e9, STOP_S)
                last_ns = r.t_ns
                robot.move(velocity(touch, dt_s))
                ages_ms.append(age_ms)
                if last_ns - first_ns > args.seconds * 1e9:
                    break
    except ts.TacshadeError as error:
        print(f"{args.sensor}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        pass
    if len(ages_ms) > 1:
        rate = (len(ages_ms) - 1) / ((last_ns - first_ns) / 1e9)
        print(
            f"{len(ages_ms)} touches, {rate:.1f} a second, {statistics.median(ages_ms):.1f} ms "
            "old in the median"
        )
    return 0


def numbers(r: ts.Result, names: Sequence[str]) -> Mapping[str, float] | None:
    """Read these numbers of a frame's touch; None if one of them is unknown,
    for example without contact.
    """
    touch = r.touch or {}
    found = {name: value for name in names if (value := touch.get(name)) is not None}
    return found if len(found) == len(names) else None


PROPORTIONAL_PER_S = 4.0
INTEGRAL_PER_S2 = 4.0
"""Without delay, both poles are at -2/s: an error decays within about a second,
even if it would grow steadily.
"""


@dataclass(slots=True)
class Loop:
    """A proportional-integral controller with a greatest velocity, in the error's unit per second.

    `held` is the integral part of the velocity, which stays constant while the limit applies.
    """

    limit: float
    held: float = 0.0

    def velocity(self, error: float, dt_s: float) -> float:
        """Compute the velocity that reduces an error to 0;
        `dt_s` is the time since the last call.
        """
        held = self.held + INTEGRAL_PER_S2 * error * dt_s
        wanted = PROPORTIONAL_PER_S * error + held
        if abs(wanted) <= self.limit:
            self.held = held
        return max(-self.limit, min(self.limit, wanted))
