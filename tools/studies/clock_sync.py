"""Measure clock synchronisation against the truth, on simulated lines and in simulated time.

::

    .venv/bin/python -m tools.studies.clock_sync [--minutes 20] [--seeds 5] [--period 1] [--drift-ppm 40]

A robot with an offset and drifting clock that warms up sends SYNC; ten times a second the study compares the daemon's
estimate of the robot's time with the truth. It reports the first 10 s separately: the line is fitted to few exchanges
then. With ``--one-way`` the robot sends 100 poses a second and no SYNC.
"""

from __future__ import annotations

import argparse
import math
import random
from dataclasses import dataclass

from tacshade_edge.protocol.serial.clock_sync import ClockSync
from tools.testbed.robot_links import LINES, Clock, LineModel

WARM_S = 10.0


@dataclass(frozen=True, slots=True)
class Errors:
    """One run's signed and stated errors, both in ms, and whether each came after the first seconds."""

    rows: list[tuple[float, float, bool]]

    def rms_ms(self, warm: bool) -> float:
        """Root mean square error in ms."""
        picked = [error for error, _, late in self.rows if late is warm]
        return math.sqrt(sum(e * e for e in picked) / len(picked))

    def covered(self) -> float:
        """Share of all errors, the first ones included, within the stated error."""
        return sum(abs(error) <= stated for error, stated, _ in self.rows) / len(self.rows)

    def stated_ms(self) -> float:
        """Mean of the stated errors in ms."""
        return sum(stated for _, stated, _ in self.rows) / len(self.rows)


def two_way(line: LineModel, clock: Clock, seconds: float, period_s: float, rng: random.Random) -> Errors:
    """Errors with a robot that sends SYNC."""
    sync, rows = ClockSync(), []
    t4_ns: int | None = None
    base_s = 1000.0  # the daemon has been up for a while
    at_s, probed_s = 0.0, 0.0
    while at_s < seconds:
        t1_ns = clock.read_ns(at_s)
        received_s = at_s + line.to_daemon_s(rng)
        sync.sync_received(t1_ns, round(1e9 * (base_s + received_s)), t4_ns)
        sent_s = received_s + rng.expovariate(1 / 0.0001)
        sync.sync_answered(round(1e9 * (base_s + sent_s)))
        t4_s = sent_s + line.to_robot_s(rng)
        t4_ns = clock.read_ns(t4_s)
        following_s = max(at_s + period_s, t4_s)
        probed_s = max(probed_s, received_s)
        while probed_s < following_s:
            if found := sync.to_robot(round(1e9 * (base_s + probed_s))):
                error_ms = (found.t_ns - clock.read_ns(probed_s)) / 1e6
                rows.append((error_ms, found.error_ns / 1e6, probed_s >= WARM_S))
            probed_s += 0.1
        at_s = following_s
    assert sync.counts.restarts == sync.counts.outliers == 0, "a sound clock was taken for one that jumped"
    return Errors(rows)


def one_way(line: LineModel, clock: Clock, seconds: float, rng: random.Random) -> Errors:
    """Errors with a robot that sends only poses, a hundred a second."""
    sync, rows = ClockSync(), []
    arrived_s = 0.0
    for step in range(round(100 * seconds)):
        at_s = step / 100
        arrived_s = max(arrived_s, at_s + line.to_daemon_s(rng))
        sync.stamp_received(clock.read_ns(at_s), round(1e9 * (1000 + arrived_s)))
        if step % 10 == 0 and (found := sync.to_robot(round(1e9 * (1000 + at_s)))):
            rows.append(((found.t_ns - clock.read_ns(at_s)) / 1e6, found.error_ns / 1e6, at_s >= WARM_S))
    assert sync.counts.restarts == 0, "a sound clock was taken for one that jumped"
    return Errors(rows)


def run(name: str, seed: int, seconds: float, period_s: float, drift_ppm: float, one_sided: bool) -> Errors:
    """Errors of one robot on one line."""
    rng = random.Random(f"{name} {seed}")
    clock = Clock(rng.uniform(0, 1e6), rng.uniform(-drift_ppm, drift_ppm))
    if one_sided:
        return one_way(LINES[name], clock, seconds, rng)
    return two_way(LINES[name], clock, seconds, period_s, rng)


def main() -> None:
    """Print a row for each line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--period", type=float, default=1.0, help="of SYNC, in s")
    parser.add_argument("--drift-ppm", type=float, default=40)
    parser.add_argument("--one-way", action="store_true")
    args = parser.parse_args()
    print("line      RMS ms   RMS ms, first 10 s   stated ms   covered")
    for name in LINES:
        runs = [
            run(name, seed, 60 * args.minutes, args.period, args.drift_ppm, args.one_way) for seed in range(args.seeds)
        ]
        everything = Errors([row for one in runs for row in one.rows])
        print(
            f"{name:8}  {everything.rms_ms(True):6.3f}   {everything.rms_ms(False):18.3f}   "
            f"{everything.stated_ms():9.3f}   {100 * everything.covered():6.2f} %"
        )


if __name__ == "__main__":
    main()
