#!/usr/bin/env python3
"""Write docs/results: one command makes each page, which names the commit and the machine at its top.

::

    .venv/bin/python -m tools.results --stale         # list the stale pages, and why they are stale
    .venv/bin/python -m tools.results --stale --make  # make only those again
    .venv/bin/python -m tools.results objects limits  # make these

A page is stale if it does not exist, if the commit that it names is not in the history, or if its program or a file or
folder of `Page.depends_on` has changed since that commit. Each page is written as soon as its command ends, so after an
interruption only the remaining pages are missing. Pages of speed need an otherwise idle machine: if other programs
worked more than `OTHER_LOAD`, the page is not written, unless ``--busy`` allows it. Every page states this other work.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tacshade_edge.simulator.objects import OBJECTS, PAPER_OBJECTS
from tacshade_edge.studies.evaluate.report import versions

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "results"
OTHER_LOAD = 0.1
"""A page of speed is written only if other programs used at most this many cores on average."""

FIVE = ",".join(PAPER_OBJECTS)
OTHERS = ",".join(name for name in OBJECTS if name not in PAPER_OBJECTS)
EVALUATE = "tools.studies.evaluate"


def package(*paths: str) -> tuple[str, ...]:
    """Name files and folders of the package, relative to the tree."""
    return tuple(f"tacshade_edge/{path}" for path in paths)


FRAME = (
    *package("core/contact", "core/depth", "core/frame_check", "core/geometry", "core/image"),
    *package("core/profiles.py", "core/reconstruct.py", "inference"),
)
"""The code that turns an image into a result."""
SENSORS = (*FRAME, *package("core/calibration", "simulator"), "tools/testbed/simulator")
"""`FRAME`, and the code that simulates and calibrates sensors."""
SCORED = (*SENSORS, *package("studies/evaluate"))
STAGES = (*SENSORS, *package("studies/stage_times.py", "studies/evaluate/sensors.py"))
DAEMON = (*FRAME, *package("daemon", "devices", "protocol", "storage"), "tools/testbed/daemon_rig.py")
REAL = (*FRAME, *package("core/calibration", "studies/evaluate"))
FAULTS = (*package("bridge", "daemon", "devices", "protocol", "settings", "storage"), "tools/faults")


@dataclass(frozen=True, slots=True)
class Page:
    """A page of docs/results.

    Attributes
    ----------
    title, text : str
        The heading, and an introduction that explains the columns.
    command : tuple of str
        ``tacshade-edge`` or a module of tools, and its arguments.
    depends_on : tuple of str
        Files and folders, relative to the tree, on which the figures depend in addition to the program itself.
    idle : bool
        Whether the page measures speed and so needs an idle machine.
    drawn : tuple of str
        Pictures that the command writes with ``--out``.
    needs : str
        A folder, relative to the tree, without which the page is skipped.
    """

    title: str
    text: str
    command: tuple[str, ...]
    depends_on: tuple[str, ...]
    idle: bool = False
    drawn: tuple[str, ...] = ()
    needs: str = ""


NOT_WRITTEN = "These commands have no page yet. Figures that other documents quote are from runs that left none."

COLUMNS = """\
"ME" is eq. 13, the mean distance from the found points to the nearest true point; "back" is the mean distance from
the true points to the nearest found point. "SD" is eq. 14 with half the sum of both ("sum": with their sum), never
clamped. "IoU" compares the found outline with skin within 0.02 mm of the object. "Depth off" is the error of the
greatest depth, mean and worst. A missed contact counts as untouched skin: SD is 0, and ME and back are the true
depth. The machine also did other work, so take milliseconds from [speed](../explanation/speed.md) instead."""

FOLLOWED = """\
Depth, tilt and shear are compared with the labels by Spearman's rank correlation and by the mean absolute error
after a linear fit (a 2x2 map) on every other frame."""

PAGES: dict[str, Page] = {
    "objects": Page(
        "The paper's five objects",
        f"""\
The paper's Experiment 1 runs on six simulated sensors reserved for final figures: three from the training family and
three from another (square lattice, mushroom pins, a skin with two decay lengths). Each sensor is calibrated on 8
references and 40 ball presses. Every object then presses it at 3 places, 1.5, 3 and 4.5 mm deep.

{COLUMNS}""",
        (EVALUATE, "--final", "--profile", "paper", "fast", "balanced", "accurate", "--objects", FIVE),
        SCORED,
        drawn=("figure6.png",),
    ),
    "other-objects": Page(
        "Eight other objects",
        f"""\
The sensors, places and depths are those of [the paper's five objects](objects.md).

{COLUMNS}""",
        (EVALUATE, "--final", "--objects", OTHERS),
        SCORED,
    ),
    "no-presses": Page(
        "One reference, no press",
        f"""\
The sensors and presses are those of [the paper's five objects](objects.md), but each sensor is calibrated on one
reference and no ball press.

{COLUMNS}""",
        (EVALUATE, "--final", "--presses", "0", "--references", "1", "--objects", FIVE),
        SCORED,
    ),
    "drag": Page(
        "Objects that are dragged, twisted and tilted",
        """\
Two simulated sensors of each family are reserved for final figures and calibrated on 8 references and 40 undragged
ball presses. All thirteen objects press at four places, 1, 2.75 and 4.5 mm deep, and each is dragged in another
direction (lengths on a skin of 20 mm). ME, SD and IoU are as for [the paper's five objects](objects.md). A "silently
wrong" frame has a greatest depth that is off by a quarter and by 0.3 mm, but is neither refused nor marked saturated or
degraded. "Shear off" is the error of a contact's mean shear. Direction errors cover contacts that moved by 0.5 mm or
more; twist errors cover all contacts.""",
        ("tools.studies.drag", "--final"),
        SCORED,
        drawn=("drag.png",),
    ),
    "sigma": Page(
        "Whether the standard deviation of each height holds",
        """\
Three simulated sensors of each family are reserved for final figures and calibrated on 8 references and 40 undragged
ball presses. Four objects that `training.fit_sigma` did not use press at four places, 1, 2.75 and 4.5 mm deep,
undragged and dragged by 2 mm (lengths on a skin of 20 mm). Only cells found in contact count; their 90 % interval is
h ± 1.645 σ. The last two columns give the share of all absolute error in the tenth of the cells with the greatest σ,
and the largest share that any tenth has. The grey band in the plot is 85 to 95 %.""",
        ("tools.studies.sigma", "--final", "--objects", "large_crescent,cone,edge,ring"),
        SCORED,
        drawn=("sigma.png",),
    ),
    "slip": Page(
        "Slips and releases over time",
        """\
Sensors of the trained family take 60 frames a second. A slip report is in time from 50 ms before to 100 ms after the
whole contact begins to slide. Held objects were dragged by 1 mm and do not slide. After a release, the skin keeps a
dent that recovers; a phantom is a frame that still, or again, shows a contact.""",
        ("tools.studies.slip",),
        SCORED,
    ),
    "limits": Page(
        "Limits",
        """\
Three simulated sensors are each calibrated on 8 references and 40 ball presses. Lengths are in mm for every skin radius
(20.0, 25.9, 22.5 mm); depth is the skin's greatest h. A phantom is a frame that wrongly shows a contact; a silent
one is not marked `degraded`.""",
        ("tools.studies.limits",),
        SCORED,
        drawn=("limits_detection.png", "limits_depth.png", "limits_resolution.png", "limits_disturbed.png"),
    ),
    "servo": Page(
        "Loops closed on the touch",
        """\
`tools/examples/servo` follows a surface at 1.5 mm and right angles, and an edge. It runs in real time through
mosquitto and the daemon, with 60 frames a second from the simulated sensor at a robot's pose. The robot obeys after
20 ms plus the added latency, and its velocity follows with a time constant of 30 ms. The surface has waves 4 mm high
and 80 mm long and slopes by up to 6° across the path; the edge has the same waves in a flat plate. The simulation
draws the surface under the sensor as its tangent plane and the edge as straight. The touch model has 400 labelled
frames of a flat plate, or of its straight edge; the tables without labels have none. The skin slides, so nothing
drags it.""",
        ("tools.examples.servo.bench",),
        (*DAEMON, *package("core/touch", "library", "simulator"), "tools/examples/servo", "tools/testbed/servo"),
        drawn=("servo.png",),
    ),
    "flange": Page(
        "Where the sensor sits on the flange",
        """\
`stitch --find-flange` runs 20 trials on three drawn surfaces with waves and the touchpad, with five sensors reserved
for final figures; the networks do not know two of these. Each trial starts 10 mm and 10° off and presses 100 times
according to [the plan](../how-to/stitching.md#the-plan); every fifth press has frames of the motion down and up. The
robot's poses have Gaussian noise in every axis, and about a random axis through the apex.""",
        ("tools.studies.flange", "--final"),
        (*SCORED, *package("core/stitching"), "tools/testbed/flange_plan.py"),
    ),
    "margin": Page(
        "The margin before a slip",
        """\
The sensors are reserved for final figures. Objects are pulled, or loosened under a drag, until they slide 0.5 to 2 s
later. A slip counts as announced if the margin falls to 0.25 at least 100 ms before its true onset. Other objects are
held at 30 to 45 % of the load that causes a slip and shaken by a quarter of their drag and 8 % of their depth, at 30
frames a second. A false alarm begins whenever the margin falls to 0.25. "Still stuck" is the share of the contact
that truly sticks at the alarm.""",
        ("tools.studies.margin", "--final", "--held", "120"),
        SCORED,
    ),
    "object-motion": Page(
        "The motion of a held object, from drawn errors",
        """\
Grasps are computed from geometry, with random errors of shear, depth and twist as measured on simulated skins. Each
combination of object, number of fingers, skin and event has 5 trials. Errors are those of the object's centre at the
end of a motion that moves a touched patch by up to 2.5 mm.""",
        ("tools.studies.object_motion", "--trials", "5", "--rest-s", "120"),
        package("core/hand"),
    ),
    "object-motion-pictures": Page(
        "The motion of a held object, from pictures",
        """\
A simulated hand of five fingers holds a box, a cylinder and a ball. It moves each object until the patch that moves
furthest has moved by 1 to 2.5 mm. Every finger's picture is drawn and reconstructed (`balanced`), for three kinds of
sensors reserved for final figures.""",
        ("tools.studies.object_motion", "--drawn", "2", "--final"),
        (*SENSORS, *package("core/hand", "hand", "protocol/hand.py")),
    ),
    "real-raw": Page(
        "A real TacTip: whole pictures",
        f"""\
The frames are those of `BioMorphic-Intelligence-Lab/aerial_tactile_servoing` without its folder with other light. The
sensor has an LED ring and white pins in the middle of the dome. The labels come from that project's own network. The
study tries two free frames of each folder as the reference and uses the first that is accepted. {FOLLOWED}""",
        ("tools.studies.real_frames", "raw", "out/real/aerial_tactile_servoing"),
        REAL,
        needs="out/real/aerial_tactile_servoing",
    ),
    "real-binary": Page(
        "A real TacTip: near-binary pictures",
        """\
The frames of `marselap/tactip-cnn-bayes` show few pins and almost only black and white. The data set does not state
which frames are free or how deep the others are. The picture closest to the mean of all serves as the reference.""",
        ("tools.studies.real_frames", "binary", "out/real/tactip-cnn-bayes"),
        REAL,
        needs="out/real/tactip-cnn-bayes",
    ),
    "touch": Page(
        "A touch as a few numbers, by labels",
        """\
A touch model (`calibrate --labels`) learns from the thresholded frames of the robot `cr_tactip` in
`dexterousrobot/tactile_data_shear`. Every frame counts; if the model has no answer, the labels' mean is the guess.
`random` draws the labels from both runs of the robot and judges 1000 other frames. `grouped` learns from the first
run and judges the second. Figures are means of four draws of the labels; those with 4000 labels have one
draw.""",
        ("tools.studies.touch", "out/real/tactile_data_shear"),
        REAL,
        needs="out/real/tactile_data_shear",
    ),
    "real-plates": Page(
        "A real TacTip: tilted and sheared plates",
        f"""\
The frames are thresholded ones of the robot `cr_tactip` in `dexterousrobot/tactile_data_shear`. No frame is free, so
the least pressed one serves as the reference. {FOLLOWED}""",
        ("tools.studies.real_frames", "plates", "out/real/tactile_data_shear"),
        REAL,
        needs="out/real/tactile_data_shear",
    ),
    "calibration": Page(
        "What `calibrate` finds wrong",
        """\
`calibrate` reports on correct sets and on sets with one mistake, from random simulated sensors with 5 references and
24 presses each. For a re-zero, "said" counts correct answers, whether accepted or refused.""",
        ("tools.studies.calibration", "--sensors", "30", "--detect", "16", "--first", "8400"),
        SENSORS,
    ),
    "fit": Page(
        "What `calibrate --fit` is worth",
        """\
Simulated sensors (numbers: the trained family) are calibrated on 5 references and 40 presses up to 4.5 mm deep (balls
of three sizes, flat ends of two, a square, a lying bar; `/balls`: only balls) with errors in the stated values, and
fitted to the same presses. The paper's five objects judge the fits at 3 places: 1.5, 3 and 4.5 mm deep, dragged by
2 mm, and 6 mm deep, a third deeper than the deepest press. "Worst" is the worst object's mean, but in the first table
the worst sensor. A fit that is no better on held-out presses is dropped. ME, SD and IoU are as for
[the paper's five objects](objects.md).""",
        ("tools.studies.fit", "--folder", "out/fit"),
        (*SCORED, *package("fitting")),
    ),
    "stages": Page(
        "A frame, stage by stage",
        """\
One thread reconstructs grey 640x480 images from memory, with a contact that covers a fifth of the disc. The floor is
`cv2.threshold` plus `cv2.boxFilter` over the whole frame. Figures are milliseconds, medians of five alternating
rounds.""",
        ("tools.benchmarks.stages",),
        STAGES,
        idle=True,
    ),
    "tradeoff": Page(
        "Speed against accuracy, setting by setting",
        """\
Every profile, and variants that differ from it in one or two settings, measure the same presses: two sensors, the
paper's five objects at one of three places each, three depths. Brackets give the 95 % interval over presses or rounds
(bootstrap). p50 and p99 are the processor time of one thread for a frame in contact; "idle" is for a frame without
contact; "MiB" is memory beyond a process with the libraries. A setting is on the front if no other is clearly better
in ME or p50 without being clearly worse in the other. ME covers few presses and only compares settings; [the paper's
five objects](objects.md) shows how good a profile is.""",
        ("tacshade-edge", "tradeoff"),
        (*STAGES, *package("studies/evaluate", "studies/tradeoff")),
        idle=True,
        drawn=("tradeoff.png",),
    ),
    "daemon": Page(
        "The daemon",
        """\
The daemon reads 640x480 at 60 frames a second from a ring of images in memory; mosquitto and a subscriber run in
separate processes. For comparison, a null daemon publishes prepared bytes. Latency runs from the frame's time stamp to
the decoded height map. In `contact`, a ball goes in and out, and all topics have a subscriber; in `free`, nothing
touches; in `unasked`, no topic has a subscriber.""",
        ("tools.benchmarks.daemon", "--seconds", "60", "--runs", "2"),
        DAEMON,
        idle=True,
    ),
    "recording": Page(
        "A recording beside the daemon",
        """\
The rows repeat `contact` of [the daemon](daemon.md) with the profile `fast`: without a recording, with a pre-roll of
10 s (`recorder.pre_roll_s`), and while every frame is recorded as a folder and as MCAP.""",
        ("tools.benchmarks.daemon", "--record", "--profile", "fast", "--seconds", "20", "--runs", "2"),
        DAEMON,
        idle=True,
    ),
    "memory": Page(
        "Memory of the daemon",
        "The command `run` works as in the service, but on images instead of a camera. Memory is in MB, from /proc.",
        ("tools.benchmarks.memory",),
        DAEMON,
        idle=True,
    ),
    "arm": Page(
        "A frame on a board's processor, emulated",
        """\
A 640x480 frame with a contact that covers a fifth of the disc runs on QEMU's model of a Pi 5's processor, with Debian's
Python 3.11. `gate` covers everything up to the contact gate (without contact: for a skin judged before), `depth`
includes objects and cloud, `encode` all payloads, `publish` the broker's client. Instruction counts are exact.
Times are estimated from these counts, with such processors' rates for scalar code that waits and for vector code, and
are right within a factor of two. No board was measured.""",
        ("tools.ci.run_arm", "--count-only"),
        (*DAEMON, "systemd/requirements.lock", "tools/ci/arm_frames.py", "tools/ci/run_arm.py", "tools/rig/arm64.py"),
    ),
    "faults": Page(
        "Faults in real parts",
        """\
Each row shows one fault of a working daemon, with a separate process, a real mosquitto, ptys and a small file system.
"Detected" is the time in seconds from the fault to the daemon's report, "recovered" from the fault's end until the
daemon works again. [Reliability](../explanation/reliability.md) states what the daemon promises.""",
        ("tools.faults", "table"),
        FAULTS,
    ),
}


def shown(command: Sequence[str]) -> str:
    """Write a command as a person types it."""
    program, *arguments = command
    return " ".join((program if program == "tacshade-edge" else f".venv/bin/python -m {program}", *arguments))


def git(*words: str) -> str:
    """Run git and return its output."""
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def commit() -> str:
    """Name the last commit that changed code, and whether there are uncommitted changes."""
    code = ("--", ".", ":!docs", ":!*.md")
    changed = " and uncommitted changes" if git("status", "--porcelain", *code) else ""
    return git("log", "-1", "--format=%h of %cs", *code) + changed


def machine() -> str:
    """Describe the machine: processor, cores, kernel."""
    names = re.findall(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    name = names[0] if names else "unnamed processor"
    return f"{name}, {len(os.sched_getaffinity(0))} cores, {platform.machine()}, Linux {platform.release()}"


def worked_s() -> tuple[float, float]:
    """Read the processor seconds of the whole machine, and those of this process's finished children."""
    user, nice, system, _idle, _wait, irq, softirq, *_ = map(int, Path("/proc/stat").read_text().split()[1:9])
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    ticks = user + nice + system + irq + softirq
    return ticks / os.sysconf("SC_CLK_TCK"), children.ru_utime + children.ru_stime


def write(name: str, page: Page, *, busy: bool) -> str:
    """Run a page's command and write the page; return a problem, or an empty string."""
    with tempfile.TemporaryDirectory() as out:
        program, *arguments = page.command
        module = "tacshade_edge" if program == "tacshade-edge" else program
        drawing = ["--out", out] if page.drawn else []
        code, before, start = commit(), worked_s(), time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", module, *arguments, *drawing],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            text=True,
            check=False,
        )
        took_s = time.monotonic() - start
        after = worked_s()
        wrong = f"{shown(page.command)}: exit code {done.returncode}" if done.returncode else ""
        # A benchmark that misses its own bar has still measured.
        if wrong and (done.returncode != 1 or "|" not in done.stdout):
            return wrong
        other = max(0.0, (after[0] - before[0]) - (after[1] - before[1])) / took_s
        if page.idle and other > OTHER_LOAD and not busy:
            return f"{name}: something else took {other:.2f} cores meanwhile; not written (--busy writes it)"
        top = (
            ("command", f"`{shown(page.command)}`"),
            ("code", code),
            ("machine", machine()),
            ("versions", ", ".join(f"{package} {number}" for package, number in versions().items())),
            ("took", f"{took_s:.0f} s, beside other work of {other:.2f} cores"),
            *([("verdict", "missed: exit code 1")] if wrong else []),
        )
        printed = done.stdout.strip()
        for folder in (ROOT, tempfile.gettempdir()):  # pages contain no absolute paths of this machine
            printed = printed.replace(f"{folder}/", "")
        lines = [f"# {page.title}", f"Written by `tools/results.py {name}`.", page.text]
        lines += ["\n".join(("| | |", "|---|---|", *(f"| {key} | {value} |" for key, value in top)))]
        lines += [printed if "|" in printed else f"```\n{printed}\n```"]
        FOLDER.mkdir(exist_ok=True)
        for picture in page.drawn:
            shutil.copy(Path(out) / picture, FOLDER / picture)
            lines.append(f"![{picture.removesuffix('.png').replace('_', ' ')}]({picture})")
        (FOLDER / f"{name}.md").write_text("\n\n".join(lines) + "\n", encoding="utf-8")
        return wrong


def index() -> None:
    """Write the lists of existing pages, of pages that other commands write, and of missing pages."""
    rows = [f"| [{PAGES[name].title}]({name}.md) | `{name}` |" for name in written()]
    others = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem not in {*PAGES, "README"})
    for name in others:
        title = (FOLDER / f"{name}.md").read_text(encoding="utf-8").partition("\n")[0].removeprefix("# ")
        rows.append(f"| [{title}]({name}.md) | |")
    missing = [
        f"- `{name}`, {page.title}: `{shown(page.command)}`" for name, page in PAGES.items() if not is_there(name)
    ]
    head = "# Results\n\n`python -m tools.results NAME` writes such a page with its command, commit and machine."
    lines = [head, "", "| page | name |", "|---|---|", *rows]
    if missing:
        lines += [
            "",
            "## Not written",
            "",
            NOT_WRITTEN,
            "",
            *missing,
        ]
    (FOLDER / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


def is_there(name: str) -> bool:
    """Whether a page exists."""
    return (FOLDER / f"{name}.md").exists()


def written() -> list[str]:
    """List the existing pages in the order of `PAGES`."""
    return [name for name in PAGES if is_there(name)]


def named_commit(text: str) -> str:
    """Find the commit that a page names; an empty string if it names none or was made with uncommitted changes."""
    found = re.search(r"^\| code \| ([0-9a-f]{7,40}) of \d{4}-\d\d-\d\d(?! and uncommitted)", text, re.MULTILINE)
    return found[1] if found else ""


def is_in_history(commit: str) -> bool:
    """Whether a commit is HEAD or one of its ancestors."""
    command = ["git", "merge-base", "--is-ancestor", commit, "HEAD"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, check=False).returncode == 0


def why_stale(name: str, page: Page) -> str:
    """Say why a page must be made again; an empty string if it is up to date."""
    if not is_there(name):
        return "is not written"
    made_of = named_commit((FOLDER / f"{name}.md").read_text(encoding="utf-8"))
    if not made_of:
        return "names no commit"
    if not is_in_history(made_of):
        return f"names {made_of}, which is not in the history"
    paths = ("--", *depends_on(page))
    if changes := git("log", "--format=%h %s", f"{made_of}..HEAD", *paths).splitlines():
        return f"commits since {made_of}: {len(changes)}, the last {changes[0]}"
    return f"uncommitted changes since {made_of}" if git("status", "--porcelain", *paths) else ""


def depends_on(page: Page) -> tuple[str, ...]:
    """List the files and folders, relative to the tree, whose changes make a page stale."""
    program = page.command[0]
    if program == "tacshade-edge":
        return page.depends_on
    path = program.replace(".", "/")
    return (*page.depends_on, path if (ROOT / path).is_dir() else f"{path}.py")


def main() -> int:
    """List or make pages; exit code 1 if a page fails."""
    parser = argparse.ArgumentParser(description="Make the pages of docs/results, or list those that are stale.")
    parser.add_argument("pages", nargs="*", metavar="PAGE", help="make these, stale or not")
    parser.add_argument("--stale", action="store_true", help="list the pages that are stale, and why")
    parser.add_argument("--make", action="store_true", help="with --stale: make them again")
    parser.add_argument("--busy", action="store_true", help="write pages of speed also beside other work")
    args = parser.parse_args()
    if unknown := [name for name in args.pages if name not in PAGES]:
        parser.error(f"{unknown[0]!r} is none of {', '.join(PAGES)}")
    if bool(args.pages) == args.stale or (args.make and not args.stale):
        parser.error("give either pages or --stale [--make]")
    names = args.pages
    if args.stale:
        stale = {name: why for name, page in PAGES.items() if (why := why_stale(name, page))}
        print("\n".join(f"{name:16} {why}" for name, why in stale.items()) or "no page is stale")
        names = list(stale) if args.make else []
    failed = False
    for name in names:
        if not (ROOT / PAGES[name].needs).exists():
            print(f"{name}: {PAGES[name].needs} is not there; not written")
            continue
        print(f"{name} ...", flush=True)
        problem = write(name, PAGES[name], busy=args.busy)
        print(problem or f"{name} written", flush=True)
        failed |= bool(problem)
    if names:
        index()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
