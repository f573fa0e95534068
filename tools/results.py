#!/usr/bin/env python3
"""Make pages of docs/results again.

::

    .venv/bin/python -m tools.results            # list stale pages, why, and how long each takes
    .venv/bin/python -m tools.results drag slip  # run these pages' commands, write their tables
    .venv/bin/python -m tools.results --mark     # write or remove the lines "Older than the code"

A person writes a page's title and text; this program replaces everything below, from the first line
"Made with", by what the page's commands print. A table of more than `LONG` rows also goes into a
CSV file beside the page.

A page is stale if its fingerprint (tools/fingerprint.py) is not that of the code: networks, golden
results, and the page's own programs; for pages of speed, also the code that a frame passes. `make
check` fails for a stale page that is not in `OLDER`. Pages of speed need an otherwise idle machine.
"""

from __future__ import annotations

import csv
import io
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from tools.fingerprint import NETWORKS, changed, fingerprint

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "results"
OTHER_LOAD = 0.1
"""A page of speed is written only if other programs used at most this many cores on average."""
LONG = 30
EVALUATE = "tools.studies.evaluate --final --objects"
FIVE = "cube,small_crescent,ball,large_crescent,cylinder"
REAL = "tools.studies.real_frames"
DETECTION = "tools.studies.detection"
FIT = "tools.studies.fit --folder out/fit/CODE --cases"
"""Its folder keeps finished cases, those of this CODE alone."""
STRANGERS = "tools.studies.strangers.evaluate --states out/strangers --folder out/strangers/kept"
THIRD = "tools.studies.third_family.evaluate --range"
FRAME = ("tacshade_edge/sensor", "tacshade_edge/sensor/inference")
"""What a frame passes."""
SERVED = (*FRAME, "tacshade_edge/daemon", "tacshade_edge/devices", "tacshade_edge/wire")
JUDGES = ("tacshade_edge/sensor/frame_check",)


@dataclass(frozen=True, slots=True)
class Page:
    """The commands of a page (modules and their arguments) by heading; the first has none.

    `profiles` are those that it shows. `code` names folders that decide its figures beside its own
    programs and the golden results. `drawn` are pictures that the first command writes into
    `--out`.
    """

    commands: dict[str, str]
    profiles: tuple[str, ...] = NETWORKS
    code: tuple[str, ...] = ()
    idle: bool = False
    drawn: tuple[str, ...] = ()

    def fingerprint(self) -> str:
        """Fingerprint what decides the page's figures now."""
        return fingerprint(map(program_of, self.commands.values()), self.code, self.profiles)


PAGES = {
    "objects": Page(
        {
            "": f"{EVALUATE} {FIVE} --profile paper fast balanced accurate",
            "Eight other objects": f"{EVALUATE} bar,cone,cross,edge,plate,prism,ring,two_balls",
            "One reference, no press": f"{EVALUATE} {FIVE} --presses 0 --references 1",
            "The network's outline and two means": (
                f"tools.studies.outline --final --objects {FIVE}"
            ),
            "Objects that touch each other": "tools.studies.touching --final",
        },
        profiles=("paper", *NETWORKS),
    ),
    "paper": Page(
        {
            "": "tools.studies.paper --final --states out/third",
            "A sensor that gives Table I": "tools.studies.identified",
            "Experiment 2": "tools.studies.paper_pad --step 6",
        },
        drawn=("paper.png",),
    ),
    "drag": Page({"": "tools.studies.drag --final"}),
    "sigma": Page({"": "tools.studies.sigma --final --objects large_crescent,cone,edge,ring"}),
    "limits": Page(
        {
            "": "tools.studies.limits",
            "Which judge refuses a frame": "tools.studies.judges --frames 74",
        },
        code=JUDGES,
    ),
    "tradeoff": Page(
        {"": "tacshade_edge tradeoff --plot", "Three users": "tools.benchmarks.users"},
        code=SERVED,
        idle=True,
        drawn=("tradeoff.png",),
    ),
    "image-size": Page(
        {"": "tools.studies.image_size --final --profile balanced accurate"},
        profiles=("balanced", "accurate"),
        code=("tacshade_edge/calibration",),
    ),
    "daemon": Page(
        {"": "tools.benchmarks.daemon --seconds 60 --runs 2"},
        code=SERVED,
        idle=True,
    ),
    "real-frames": Page(
        {
            "": f"{REAL} raw out/real/aerial_tactile_servoing",
            "Whole pictures, fitted to the reference": (
                f"{REAL} raw out/real/aerial_tactile_servoing --fit"
            ),
            "By which picture is the reference": (
                f"{REAL} raw out/real/aerial_tactile_servoing --references 3"
            ),
            "By which picture is the reference, fitted": (
                f"{REAL} raw out/real/aerial_tactile_servoing --references 3 --fit"
            ),
            "Tilted and sheared plates": f"{REAL} plates out/real/tactile_data_shear",
            "Flat presses of stated depth": f"{REAL} flat out/real/TacTipFlexSim",
            "Raw pictures of tilted and sheared plates": (
                f"{REAL} tilted out/real/tactile-manibot --frames 6425"
            ),
            "Taps of a tilted plane, 127 pins": f"{REAL} pins out/real/Tac-VGNN",
        },
        code=(*JUDGES, "tacshade_edge/lab/fitting"),
    ),
    "detection": Page(
        {
            "": f"{DETECTION} simulated --final --frames 40 --untouched 200",
            "A pad whose force is known": f"{DETECTION} tilted out/real/tactile-manibot",
            "Tips that sway": f"{DETECTION} raw out/real/aerial_tactile_servoing --step 4",
            "Flat presses of stated depth": f"{DETECTION} flat out/real/TacTipFlexSim",
        },
    ),
    "recognise": Page(
        {"": "tools.studies.recognise --final"}, code=("tacshade_edge/sensor/recognition",)
    ),
    "slip": Page({"": "tools.studies.slip"}, code=("tacshade_edge/sensor/contact",)),
    "servo": Page(
        {"": "tools.examples.servo.bench"},
        code=SERVED,
        drawn=("servo.png",),
    ),
    "fit": Page(
        {
            "": f"{FIT} 9028/none,other:9028/none,9029/none,other:9029/none",
            "With 40 presses": f"{FIT} 9028,other:9028,9029,other:9029",
            "What the fit knows": (
                f"{FIT} 9027/drawing,other:9027/drawing,9027/exact,9027/slow,9027/steep"
            ),
        },
    ),
    "strangers": Page(
        {
            "": f"{STRANGERS} --families third --range final",
            "Do touches rank maps?": (
                "tools.studies.strangers.explained --states out/strangers --range final --sensors 2"
            ),
            "Layered and oblate skins": f"{STRANGERS} --families layered,oblate --range final",
        },
    ),
    "factors": Page(
        {
            "": "tools.studies.factors --states out/strangers --range final",
            "Presses of seven shapes": "tools.studies.factors --mixed",
        },
        code=("tacshade_edge/calibration",),
    ),
    "third-family": Page(
        {
            "": f"{THIRD} working --sensors 6 --ways 2 --states out/third",
            "Final range": f"{THIRD} final --sensors 6 --ways 2 --states out/third",
            "Final range, 40 presses": (
                f"{THIRD} final --sensors 6 --ways 2 --states out/third --presses 40"
            ),
        },
    ),
    "touch": Page(
        {
            "": "tools.studies.touch force out/real/tactile-manibot --profile accurate",
            "Thresholded frames of another robot": (
                "tools.studies.touch plates out/real/tactile_data_shear --profile accurate "
                "--labels 4000 400 100"
            ),
        },
        code=("tacshade_edge/sensor/touch",),
        drawn=("touch.png",),
    ),
    "ageing": Page(
        {
            "": "tools.studies.ageing years --sensors 21 --final",
            "What wear costs": "tools.studies.ageing errors --sensors 3 --final",
        },
        profiles=("balanced", "accurate"),
        code=("tacshade_edge/calibration/ageing",),
    ),
    "mujoco": Page(
        {"": "tools.studies.mujoco_presses", "Force and friction": "tools.studies.mujoco_forces"},
        profiles=(),
        code=("tacshade_edge/lab/mjcf",),
    ),
    "growth": Page({"": "tools.benchmarks.growth"}),
    "arm": Page({"": "tools.ci.run_arm --count-only"}, profiles=("paper", *NETWORKS), code=FRAME),
    "faults": Page({"": "tools.faults table", "The test suite's trials": "tools.faults trials"}),
}
OLDER = (
    "objects",
    "drag",
    "sigma",
    "detection",
    "recognise",
    "limits",
    "paper",
    "image-size",
    "daemon",
    "real-frames",
    "slip",
    "servo",
    "fit",
    "third-family",
    "touch",
)
"""Pages that could not be made again with the code, and say so at their top.

The list only shrinks.
"""
FINGERPRINT = re.compile(r", code ([0-9a-f]+(?:-[0-9a-f]+)+)")
MARK = re.compile(r"^> \*\*Older than the code\.\*\* .*\n\n", re.MULTILINE)


def program_of(command: str) -> str:
    """Name the module that does a command's work."""
    program, verb, *_ = (*command.split(), "")
    return f"tacshade_edge.cli.commands.{verb}" if program == "tacshade_edge" else program


def long_tables(printed: str) -> list[str]:
    """The tables of more than `LONG` rows, as CSV."""
    found = []
    for block in printed.split("\n\n"):
        lines = block.splitlines()
        if block.startswith("|") and len(lines) > LONG + 2:
            rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
            text = io.StringIO()
            csv.writer(text, lineterminator="\n").writerows([rows[0], *rows[2:]])
            found.append(text.getvalue())
    return found


def git(*words: str) -> str:
    """Run git and return its output."""
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def made_with(command: str, code: str, seconds: float, other: float) -> str:
    """Say how figures were made: by which command, commit and machine, how long,
    beside how much other work.
    """
    files = ("--", ".", ":!docs", ":!*.md")
    commit = git("log", "-1", "--format=%h of %cs", *files)
    edited = " with uncommitted changes" if git("status", "--porcelain", *files) else ""
    names = re.findall(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    name = names[0].replace("(R)", "").replace(" Processor", "") if names else "unnamed processor"
    count = len(os.sched_getaffinity(0))
    machine = f"{name}, {count} core{'s' if count > 1 else ''}"
    made = f"at {commit}{edited}, code {code}, in {seconds:.0f} s"
    return f"Made with `python -m {command}` {made} on {machine}; other work: {other:.2f}."


def worked_s() -> float:
    """Read the processor seconds of the whole machine,
    less those of this process's finished children.
    """
    user, nice, system, _idle, _wait, irq, softirq, *_ = map(
        int, Path("/proc/stat").read_text().split()[1:9]
    )
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (
        (user + nice + system + irq + softirq) / os.sysconf("SC_CLK_TCK")
        - children.ru_utime
        - children.ru_stime
    )


def write(name: str, page: Page) -> None:
    """Run a page's commands and write the page; exit if a command fails
    or the machine is not idle.
    """
    file, code = FOLDER / f"{name}.md", page.fingerprint()
    written = MARK.sub("", file.read_text(encoding="utf-8"))
    parts = [re.split(r"^(?:Made with|## )", written, maxsplit=1, flags=re.MULTILINE)[0].strip()]
    tables: list[str] = []
    with tempfile.TemporaryDirectory() as out:
        for heading, command in page.commands.items():
            before, start = worked_s(), time.monotonic()
            drawing = ["--out", out] if page.drawn and not heading else []
            words = [sys.executable, "-m", *command.replace("CODE", code).split(), *drawing]
            done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
            # A benchmark that misses its own bar exits with 1, but has still measured.
            if done.returncode and (done.returncode != 1 or "|" not in done.stdout):
                sys.exit(f"{name}: {command}: exit code {done.returncode}")
            seconds = time.monotonic() - start
            other = max(0.0, worked_s() - before) / seconds
            if page.idle and other > OTHER_LOAD:
                sys.exit(f"{name}: other programs took {other:.2f} cores meanwhile; not written")
            printed = done.stdout.replace(f"{ROOT}/", "").strip()
            made = made_with(command, code, seconds, other)
            parts += [*([f"## {heading}"] if heading else []), made, printed]
            tables += long_tables(printed)
        for picture in page.drawn:
            shutil.copy(Path(out) / picture, FOLDER / picture)
            parts.append(f"![{picture.removesuffix('.png').replace('_', ' ')}]({picture})")
    if page.fingerprint() != code:
        sys.exit(f"{name}: the code changed meanwhile; not written")
    parts += write_tables(name, tables)
    file.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def write_tables(name: str, tables: list[str]) -> list[str]:
    """Write long tables beside the page, in place of earlier ones,
    and return the line that links to them.
    """
    for old in FOLDER.glob(f"{name}-[0-9].csv"):
        old.unlink()
    links = []
    for number, table in enumerate(tables, start=1):
        file = FOLDER / f"{name}-{number}.csv"
        file.write_text(table, encoding="utf-8")
        links.append(f"[{file.name}]({file.name})")
    return [f"The long tables as CSV: {', '.join(links)}."] if links else []


def text_of(name: str) -> str:
    """A page's text."""
    return (FOLDER / f"{name}.md").read_text(encoding="utf-8")


def commits_of(name: str) -> list[str]:
    """List the commits that a page names, none for figures of uncommitted changes."""
    return re.findall(
        r"(?:at|code \|) ([0-9a-f]{7,40}) of [\d-]{10}(?! with uncommitted)", text_of(name)
    )


def why_stale(name: str, page: Page) -> str:
    """Say why a page is stale; an empty string if it is not."""
    now, found = page.fingerprint(), FINGERPRINT.findall(text_of(name))
    if len(found) != len(page.commands):
        return f"names {len(found)} fingerprints of {len(page.commands)}"
    parts = dict.fromkeys(part for one in found for part in changed(one, now).split(", ") if part)
    return f"changed since: {', '.join(parts)}" if parts else ""


def takes(name: str) -> str:
    """How long a page took when it was made last."""
    seconds = [int(found) for found in re.findall(r", in (\d+) s on ", text_of(name))]
    return f"{sum(seconds) / 60:.1f} min" if seconds else "time not measured"


def mark_of(name: str) -> str:
    """The line at the top of a page that could not be made again."""
    text = text_of(name)
    commits = dict.fromkeys(re.findall(r"[0-9a-f]{7,40} of [\d-]{10}", text))
    less = "" if FINGERPRINT.search(text) else ", without some rows and columns,"
    return (
        f"> **Older than the code.** These figures{less} are of {', '.join(commits)};"
        f" `python -m tools.results {name}` makes them again ({takes(name)}).\n\n"
    )


def mark(name: str) -> None:
    """Write or remove the line at the top of a page."""
    title, _, rest = MARK.sub("", text_of(name)).partition("\n\n")
    line = mark_of(name) if name in OLDER else ""
    (FOLDER / f"{name}.md").write_text(f"{title}\n\n{line}{rest}", encoding="utf-8")


def mistake(name: str, page: Page) -> str:
    """What `make check` has against a page; an empty string if nothing."""
    why, listed = why_stale(name, page), name in OLDER
    if why and not listed:
        return f"{name} is older than the code ({why}): run `python -m tools.results {name}`"
    if listed and not why:
        return f"{name} is as new as the code: take it out of OLDER in tools/results.py"
    if MARK.findall(text_of(name)) != ([mark_of(name)] if listed else []):
        return f"{name}: run `python -m tools.results --mark`"
    return ""


def main() -> None:
    """List the stale pages, mark those that are older, or make those that are named."""
    names = sys.argv[1:]
    if names == ["--mark"]:
        for name in PAGES:
            mark(name)
        return
    if unknown := sorted({*names} - {*PAGES}):
        sys.exit(f"{unknown[0]!r} is none of {', '.join(PAGES)}")
    for name in names:
        write(name, PAGES[name])
        print(f"{name} written", flush=True)
        if name in OLDER:
            print(f"Take {name!r} out of OLDER in tools/results.py")
    if not names:
        stale = {name: why for name, page in PAGES.items() if (why := why_stale(name, page))}
        lines = [f"{name:12} {takes(name):>17}  {why}" for name, why in stale.items()]
        print("\n".join(lines) or "no page is stale")


if __name__ == "__main__":
    main()
