"""``tacshade-edge tradeoff``: what outputs cost and how wrong they are on this machine,
and the settings for a need.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from tacshade_edge.calibration import loading
from tacshade_edge.calibration.reference.references import with_reference
from tacshade_edge.cli.shared import study
from tacshade_edge.cli.shared.options import POSITIVE, RATE, add_option, need, number, warn
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.doctor.board import board_facts, heat
from tacshade_edge.doctor.machine import Machine
from tacshade_edge.doctor.tail import measure_tail
from tacshade_edge.errors import ConfigError, DeviceError
from tacshade_edge.lab.parallel import usable_cores, workers
from tacshade_edge.lab.simulator.press import PAPER_OBJECTS, Press
from tacshade_edge.lab.simulator.sensor_model import SensorModel
from tacshade_edge.lab.simulator.truth import SimulatedFrame, skin_under
from tacshade_edge.lab.studies.evaluate.work import (
    PRESSES,
    REFERENCE_NOISE,
    REFERENCES,
    calibrate_sensors,
)
from tacshade_edge.lab.studies.tradeoff import tradeoff_report
from tacshade_edge.lab.studies.tradeoff.judging import (
    OUTPUTS,
    JudgedFrames,
    Setting,
    Simulation,
    judge,
    outputs_of,
    settings,
    simulated,
)
from tacshade_edge.lab.studies.tradeoff.measure import Offer, measure
from tacshade_edge.lab.trial.trial import TrialBroker, Wanted, try_daemon
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.sensor.image.preprocess import halved_calibration
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.settings import load_all
from tacshade_edge.types import F32, Calibration

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.lattice import Layout
    from tacshade_edge.lab.fitting.prints import Kind

SENSORS = "default,5"
BUSY = 1.1
"""Ratio of wall time to processor time above which other programs kept the machine busy."""
USUAL_HZ, TAIL_S = 30.0, 5.0
"""The daemon's rate where none is asked, and how long the machine's own tail is measured without
a daemon.
"""
TRIED_MAX = 3
"""Settings that the daemon is tried with, the most accurate first: each takes half a minute."""
TOUCHED_MAX, UNTOUCHED_MAX = 24, 8
"""Images that the daemon sees, over and over."""
WIDEST_PX = 400
"""Greatest width of the image in which a print is sought."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    study.add_arguments(parser, "default: all", "tradeoff.md, tradeoff.csv and tradeoff.json")
    wish = parser.add_argument_group(
        "what you need; prints the settings of the most accurate that holds it"
    )
    add_option(wish, "--budget-ms", "MS", "time for 99 of 100 frames in contact", POSITIVE)
    add_option(wish, "--fps", "N", "frames per second of each finger", RATE)
    text = "number of fingers on this machine (default: 1)"
    add_option(wish, "--fingers", "N", text, number("a number from 1 to 100", 1, 100, int))
    text = f"one or more of {', '.join(OUTPUTS)}, together (default: each alone, and all)"
    add_option(wish, "--outputs", "NAME,...", text, _outputs)
    text = "settings of the trial's broker (default: a private one)"
    add_option(wish, "--config", "FILE", text)
    parser.add_argument("--plot", action="store_true", help="with --out: also write tradeoff.png")
    text = (
        "time only the learned profiles and print a report to send in; "
        "it omits this board's host name"
    )
    parser.add_argument("--report", action="store_true", help=text)
    study.add_simulated(parser, SENSORS, "the paper's five")


def _outputs(text: str) -> tuple[str, ...]:
    names = {word.strip() for word in text.split(",")}
    if unknown := sorted(names - {*OUTPUTS}):
        raise argparse.ArgumentTypeError(
            f"found {unknown[0]!r}, expected one or more of {', '.join(OUTPUTS)}"
        )
    return tuple(name for name in OUTPUTS if name in names)


def run(args: argparse.Namespace) -> int:
    if args.plot and args.out is None:
        args.parser.error("--plot requires --out")
    with study.own_folder(args, "tradeoff"):
        return _report(args) if args.report else _measured(args)


def _measured(args: argparse.Namespace) -> int:
    """Measure, print and write the offers, and try the daemon with what is recommended."""
    drawn = args.plot and study.will_draw(args, "tradeoff.png")
    profiles = tuple(dict.fromkeys(args.profile or PROFILES))
    mistakes: list[str] = []
    study.check_out(args, "tradeoff", ("tradeoff.png",) if args.plot else ())
    is_own = args.images is not None and study.is_own(args, ("sensors", "objects", "cluster"))
    every = _outputs_of(args, profiles)
    # A calibration alone gives a twin; only with images it is judged on those.
    if is_own:
        calibration, cases, mistakes = study.own_images(args)
        some = settings(profiles, calibration)
        judged = judge(some, calibration, cases)
    else:
        some, calibration, judged = _simulated(args, profiles)
    if not any(each.touched for each in judged):
        expected = "found no image of a contact to score, expected at least one with a truth file"
        raise ConfigError(f"{args.images}: {expected}")
    asked = [args.outputs] if args.outputs else [*((name,) for name in every), every]
    rows, busy = measure(some, asked, calibration, judged, Progress())
    # Figures are processor time, which another program's load does not change, but a table should
    # say that it was there.
    if busy > BUSY:
        warn(
            f"the machine was busy: frames took {busy:.1f} times as long as the processor time "
            "shown here"
        )
    wanted = [row for row in rows if row.outputs == asked[-1]]
    tried, text, holds = _recommend(args, wanted, calibration, judged)
    rows = [*(row for row in rows if row.outputs != asked[-1]), *tried]
    csv = {"": tradeoff_report.csv_text(rows)}
    study.publish(
        args, "tradeoff", tradeoff_report.table(rows), csv, tradeoff_report.document(rows, busy)
    )
    if drawn:
        study.write(args.out / "tradeoff.png", tradeoff_report.draw(rows, args.budget_ms))
    if not holds:
        warn(text)
    elif text:
        print(f"\n{text}", file=sys.stderr if args.json else sys.stdout)
    return 0 if holds and not mistakes else 1


def _outputs_of(args: argparse.Namespace, profiles: Sequence[str]) -> tuple[str, ...]:
    """The outputs that profiles have; a usage error if one was asked for that none has."""
    if args.images is None and args.calibration is not None and args.sensors is not None:
        args.parser.error("--sensors cannot be used with --calibration")
    if args.images is None and args.calibration is not None:
        _need_twin()
    # Simulated sensors have no touch model.
    touch = () if args.calibration is None else loading.load(args.calibration).touch
    found = {name for profile in profiles for name in outputs_of(profile, touch)}
    if missing := [name for name in args.outputs or () if name not in found]:
        args.parser.error(f"--outputs: these profiles have no {missing[0]} with this calibration")
    return tuple(name for name in OUTPUTS if name in found)


def _recommend(
    args: argparse.Namespace,
    rows: Sequence[Offer],
    calibration: Calibration,
    judged: Sequence[JudgedFrames],
) -> tuple[Sequence[Offer], str, bool]:
    """The rows, with what the daemon did where it was tried; the settings that hold what is asked,
    or why none do; whether some do.
    """
    if (args.budget_ms, args.fps, args.fingers) == (None, None, None):
        return rows, "", True
    wish = tradeoff_report.Wish(args.budget_ms, args.fps, args.fingers or 1, usable_cores())
    progress = Progress()
    try:
        # Times of the processor choose among many; what is promised, the daemon itself has held.
        with TrialBroker(args.config and load_all(args.config)[0]) as broker:
            for done in range(TRIED_MAX):
                offer, text = tradeoff_report.choose(rows, wish)
                if offer is None or offer.promise is not None:
                    return rows, text, offer is not None
                progress("daemons tried", done, TRIED_MAX)
                wanted = _wanted(offer, wish, calibration, judged)
                promise = try_daemon(wanted, broker, offer.times.p50_ms)
                rows = [replace(row, promise=promise) if row is offer else row for row in rows]
            offer, text = tradeoff_report.choose(rows, wish)
            if offer is not None and offer.promise is None:
                return rows, f"nothing holds that the daemon was tried with; untried: {text}", False
            return rows, text, offer is not None
    except DeviceError as error:
        offer, text = tradeoff_report.choose(rows, wish)
        if offer is None:
            return rows, text, False
        tail = measure_tail(offer.times.p50_ms, wish.fps or USUAL_HZ, TAIL_S)
        return rows, f"{text}\n{tradeoff_report.tail_line(offer, tail, str(error))}", True
    finally:
        progress.end()


def _wanted(
    offer: Offer,
    wish: tradeoff_report.Wish,
    calibration: Calibration,
    judged: Sequence[JudgedFrames],
) -> Wanted:
    """What the daemon is tried with: contacts, and the untouched skin between them."""
    setting, first = offer.setting, [each for each in judged if each.sensor == judged[0].sensor]
    images = [
        to_grey(setting.image(each.image))
        for is_touched, count in ((True, TOUCHED_MAX), (False, UNTOUCHED_MAX))
        for each in [one for one in first if one.touched is is_touched][:count]
    ]
    return Wanted(
        profile=setting.profile,
        calibration=halved_calibration(calibration) if setting.half else calibration,
        images=images,
        fps=wish.fps or USUAL_HZ,
        fingers=wish.fingers,
        outputs=offer.outputs,
    )


def _simulated(
    args: argparse.Namespace, profiles: tuple[str, ...]
) -> tuple[tuple[Setting, ...], Calibration, list[JudgedFrames]]:
    """Judge on simulated sensors: a twin of the user's, or the named ones;
    the calibration is the first sensor's.
    """
    progress = Progress()
    with workers(args.cluster) as pool:
        if args.calibration is not None:
            sensors = [_twin(args, progress)]
        else:
            names = args.sensors or study.sensors(SENSORS)
            found = calibrate_sensors(names, REFERENCES, PRESSES, pool, progress)
            sensors = [
                Simulation(str(name), name.seed, name.make, made.calibration)
                for name, made in zip(names, found, strict=True)
            ]
        calibration = sensors[0].calibration
        some = settings(profiles, calibration)
        return (
            some,
            calibration,
            simulated(some, sensors, args.objects or [*PAPER_OBJECTS], pool, progress),
        )


def _report(args: argparse.Namespace) -> int:
    """Measure the learned profiles in the same way on every board,
    and print the table and the board's facts.
    """
    for name in (
        "profile",
        "calibration",
        "images",
        "budget_ms",
        "fps",
        "fingers",
        "outputs",
        "config",
        "sensors",
        "objects",
        "cluster",
    ):
        if getattr(args, name) is not None:
            args.parser.error(
                f"--report measures the same on every board: expected no --{name.replace('_', '-')}"
            )
    if args.json:
        args.parser.error("--report prints Markdown: expected no --json")
    # Fixed, because a report is compared with those of other boards.
    args.report, args.outputs, args.sensors = False, ("height",), study.sensors("default")
    args.profile = [name for name, profile in PROFILES.items() if profile.network]
    machine = Machine()
    # Before the work, which heats the board: a throttled processor explains slow frames.
    facts, before = board_facts(machine), heat(machine)
    code = run(args)
    facts |= {"before": before, "after": heat(machine)} if before else {}
    print("\n" + "\n".join(f"- {name}: {text}" for name, text in facts.items()))
    return code


def _need_twin() -> None:
    need("tradeoff --calibration without --images", "fit", "numba")


def _twin(args: argparse.Namespace, progress: Progress) -> Simulation:
    """A simulation of the user's sensor, from its calibration's reference."""
    _need_twin()
    from tacshade_edge.lab.fitting import identify, lattice, prints

    calibration = loading.load(args.calibration)
    small, times = calibration, 1
    while (
        small.image_width_px > WIDEST_PX
        and small.image_width_px % 2 == small.image_height_px % 2 == 0
    ):
        # Each halving makes the search four times as fast.
        small, times = halved_calibration(small), 2 * times
    progress("finding the sensor's print", 0, None)
    found = identify.identify(small)
    if not found:
        raise ConfigError(
            f"{args.calibration}: found no pins in its reference; add --images DIR, "
            "with ground truth"
        )
    model, layout = found[0].at(found[0].values)
    if isinstance(layout, lattice.Tips):
        # A pixel of the small image covers several: its middle is between theirs.
        layout = lattice.Tips(layout.px * times + (times - 1) / 2)
    at, whole = (
        ("image_height_px", "image_width_px", "row_c", "col_c", "disc_radius_px"),
        calibration,
    )
    seen = {name: getattr(prints.base_model(whole), name) for name in at}
    model = replace(model, blur_px=model.blur_px * times, **seen)
    make = partial(OwnTwin, model, found[0].kind, layout, prints.seen_light(whole)[0])
    sensor = make()
    greys = [to_grey(sensor.frame((), REFERENCE_NOISE + k).image) for k in range(REFERENCES)]
    return Simulation("twin", None, make, with_reference(whole, greys))


class OwnTwin:
    """A simulated sensor with a print that was found (`lab.fitting.identify`)."""

    def __init__(self, model: SensorModel, kind: Kind, layout: Layout, light: F32) -> None:
        from tacshade_edge.lab.fitting.prints import TwinRenderer, print_of

        self.model = model
        self._renderer = TwinRenderer(model, kind, print_of(model, kind, layout), light)

    def frame(self, presses: Sequence[Press] = (), noise_seed: int = 0) -> SimulatedFrame:
        """Take a picture."""
        skin = skin_under(self.model, presses)
        image = self._renderer.expose(self._renderer.draw(skin), noise_seed)
        return SimulatedFrame(image, tuple(presses), skin, self.model)
