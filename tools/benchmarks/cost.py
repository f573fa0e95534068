#!/usr/bin/env python3
"""How a frame's cost grows with contact area, image size and number of objects: fitted slopes and a plot.

::

    .venv/bin/python -m tools.benchmarks.cost [--profile fast accurate] [--rounds 15] [--out FOLDER]

Times are processor times of the simulated default sensor on one thread. Balls of 2 to 40 mm radius in the middle vary
the area; one ball seen through cameras of 320x240 to 1280x960 varies the size; one to six small balls around the tip
vary the number. All trials take turns in rounds; a figure is the median over the rounds of a round's median. A slope is
that of the least-squares line; its 95 % interval comes from resampling the rounds. Writes `cost.md` and `cost.png`.
"""

from __future__ import annotations

import argparse
import io
import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.studies.evaluate.sensors import calibrated_sensor, reconstructor
from tacshade_edge.studies.stage_times import one_thread, stages_ms, work_ns
from tacshade_edge.studies.tables import markdown
from tacshade_edge.studies.tradeoff.timing import FRAME_NS
from tacshade_edge.types import F64, U8, Frame

RADII_MM, DEPTH_MM = (2.0, 3.0, 4.5, 7.0, 11.0, 18.0, 40.0), 4.0
SCALES = (0.5, 0.75, 1.0, 1.5, 2.0)
"""Image sizes as factors on 640x480."""
OBJECTS_MOST = 6
AREA, SIZE, NUMBER, IDLE = "contact area", "image size", "objects", "image size, no contact"
UNITS = {AREA: "cm²", SIZE: "Mpx", NUMBER: "object", IDLE: "Mpx"}
REFERENCES = 2
SLICE_MS = 40.0
DRAWS = 1000


@dataclass(slots=True)
class Trial:
    """A frame that is timed again and again."""

    profile: str
    against: str
    x: float
    made: Reconstructor
    image: U8
    medians_ms: list[float] = field(default_factory=list)
    count: int = 1
    t_ns: int = 0

    def round(self) -> None:
        """Time some steps; the first one after other work does not count."""
        if self.count > 1:
            self.step_ms()
        self.medians_ms.append(float(np.median([self.step_ms() for _ in range(self.count)])))

    def step_ms(self) -> float:
        """Processor time in ms of one step at 60 frames a second."""
        self.t_ns += FRAME_NS
        return sum(stages_ms(self.made, Frame(0, self.t_ns, 0, self.image), work_ns).values())


def enlarged(scale: float) -> SensorModel:
    """The default sensor through a camera of another resolution: the same picture in more or fewer pixels."""
    usual = SensorModel()
    return replace(
        usual,
        image_height_px=round(scale * usual.image_height_px),
        image_width_px=round(scale * usual.image_width_px),
        row_c=scale * (usual.row_c + 0.5) - 0.5,
        col_c=scale * (usual.col_c + 0.5) - 0.5,
        disc_radius_px=scale * usual.disc_radius_px,
        blur_px=scale * usual.blur_px,
    )


def around_the_tip(count: int) -> list[Press]:
    """Small balls on a ring."""
    turns = [2 * math.pi * k / count for k in range(count)]
    return [Press(ball(1.5), 8 * math.cos(turn), 8 * math.sin(turn), 1.5) for turn in turns]


def trials(profiles: Sequence[str]) -> Iterator[Trial]:
    """Everything that is timed."""
    for scale in SCALES:
        sensor = SimulatedSensor(enlarged(scale))
        calibration = calibrated_sensor(sensor, 0, REFERENCES, 0).calibration
        made = {profile: reconstructor(calibration, profile) for profile in profiles}
        pressed: list[tuple[str, list[Press]]] = [(SIZE, [Press(ball(6.0))]), (IDLE, [])]
        if scale == 1.0:
            pressed += [(AREA, [Press(ball(radius), depth_mm=DEPTH_MM)]) for radius in RADII_MM]
            pressed += [(NUMBER, around_the_tip(count)) for count in range(1, OBJECTS_MOST + 1)]
        for seed, (against, presses) in enumerate(pressed):
            image = sensor.frame(presses, seed).image
            for profile, each in made.items():
                result = each.step(Frame(0, 0, 0, image))
                if result.contact != bool(presses):
                    sys.exit(
                        f"benchmarks.cost: {profile} finds {len(result.objects)} contacts where {len(presses)} are"
                    )
                area = sum(o.area_mm2 for o in result.objects) / 100
                x = {AREA: area, NUMBER: float(len(result.objects))}.get(against, image[..., 0].size / 1e6)
                yield Trial(profile, against, x, each, image)


def measure(timed: Sequence[Trial], rounds: int) -> None:
    """Time all trials in turns."""
    rng = np.random.default_rng(0)
    with one_thread():
        for each in timed:
            each.count = max(1, int(SLICE_MS / min(each.step_ms() for _ in range(2))))
        for done in range(rounds):
            if sys.stderr.isatty():
                print(f"\rrounds: {done}/{rounds} ", end="", file=sys.stderr, flush=True)
            for k in rng.permutation(len(timed)):
                timed[k].round()
        if sys.stderr.isatty():
            print(file=sys.stderr)


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """A fitted line and its data."""

    x: F64
    ms: F64
    slope: float
    slope_low: float
    slope_high: float
    at_zero_ms: float
    off_ms: float

    @classmethod
    def through(cls, some: Sequence[Trial]) -> Line:
        """Fit the medians; resample the rounds for the interval."""
        x = np.array([each.x for each in some])
        ms = np.array([each.medians_ms for each in some])
        rounds = ms.shape[1]
        drawn = np.random.default_rng(0).integers(rounds, size=(DRAWS, rounds))
        low, high = np.percentile(np.polyfit(x, np.median(ms[:, drawn], axis=2), 1)[0], (2.5, 97.5))
        median = np.median(ms, axis=1)
        slope, at_zero = np.polyfit(x, median, 1)
        off = float(np.abs(slope * x + at_zero - median).max())
        return cls(x, median, float(slope), float(low), float(high), float(at_zero), off)


def table(lines: dict[tuple[str, str], Line]) -> str:
    """The slopes as a Markdown table."""
    cells = [
        [
            profile,
            against,
            f"{line.x.min():.2g} to {line.x.max():.2g} {UNITS[against]}",
            f"{line.ms[line.x.argmin()]:.2f} to {line.ms[line.x.argmax()]:.2f}",
            f"{line.slope:.3f} ({line.slope_low:.3f} to {line.slope_high:.3f})",
            f"{line.at_zero_ms:.2f}",
            f"{line.off_ms:.2f}",
        ]
        for (profile, against), line in lines.items()
    ]
    return markdown(
        ["method", "what", "from, to", "p50 ms", "slope, ms for each unit", "at 0 ms", "off the line by, ms"], cells
    )


def draw(lines: dict[tuple[str, str], Line]) -> bytes:
    """A PNG with a panel for each of the three quantities and a colour for each profile."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.6), dpi=100, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    colours = dict(zip(dict.fromkeys(p for p, _ in lines), ("#e4572e", "#4a9c5d", "#3d6fb4", "#8a5fb0"), strict=False))
    for axes, against in zip(figure.subplots(1, 3), (AREA, SIZE, NUMBER), strict=True):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(color="#e6e6e6", linewidth=0.8)
        for profile, colour in colours.items():
            for kind, style in ((against, "-"), *(((IDLE, ":"),) if against == SIZE else ())):
                line = lines[profile, kind]
                ends = np.array([0, line.x.max()])
                axes.plot(line.x, line.ms, "o" if kind == against else "s", color=colour, markersize=5)
                name = profile if kind == against else f"{profile}, no contact"
                said = f"{name}: {line.slope:.2f} ms for each {UNITS[kind]}"
                axes.plot(ends, line.at_zero_ms + line.slope * ends, style, color=colour, label=said)
        axes.set(xlabel=f"{against} ({UNITS[against]})" if against != NUMBER else "objects", ylabel="p50 ms")
        axes.set_xlim(left=0)
        axes.set_ylim(bottom=0)
        axes.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.13))
    stream = io.BytesIO()
    figure.savefig(stream, format="png")
    return stream.getvalue()


def main() -> None:
    """Measure, print and write the files."""
    parser = argparse.ArgumentParser(description="What a frame's cost grows with.")
    learned = [name for name in PROFILES if name != "paper"]
    parser.add_argument("--profile", nargs="+", choices=list(PROFILES), default=learned)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    timed = list(trials(args.profile))
    measure(timed, args.rounds)
    keys = [(profile, against) for profile in args.profile for against in UNITS]
    lines = {key: Line.through([each for each in timed if (each.profile, each.against) == key]) for key in keys}
    print(table(lines))
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "cost.md").write_text(table(lines) + "\n", encoding="utf-8")
        (args.out / "cost.png").write_bytes(draw(lines))


if __name__ == "__main__":
    main()
