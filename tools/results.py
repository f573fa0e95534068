#!/usr/bin/env python3
"""Make pages of docs/results again.

::

    .venv/bin/python -m tools.results            # list the pages that are stale, and why
    .venv/bin/python -m tools.results drag slip  # run the commands of these pages, and write their tables

A person writes a page's title and text; this program replaces everything below, from the first line "Made with", by
what the page's commands print, less `Page.leave_out`. A page is stale if weights, inference, `core` or its own program
changed since a commit that it names. Pages of speed need an otherwise idle machine.
"""

from __future__ import annotations

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

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "docs" / "results"
OTHER_LOAD = 0.1
"""A page of speed is written only if other programs used at most this many cores on average."""
EVALUATE = "tools.studies.evaluate --final --objects"
FIVE = "cube,small_crescent,ball,large_crescent,cylinder"
REAL = "tools.studies.real_frames"
FIT = "tools.studies.fit --folder out/fit --cases"


@dataclass(frozen=True, slots=True)
class Page:
    """The commands of a page (modules and their arguments; each but the first below a heading), and what it leaves out.

    `leave_out` is a pattern of lines above tables, column names and rows (cells joined by " | ").
    """

    commands: dict[str, str]
    leave_out: str = r"(?!)"
    idle: bool = False
    drawn: tuple[str, ...] = ()
    own: tuple[str, ...] = ()


PAGES = {
    "objects": Page(
        {
            "": f"{EVALUATE} {FIVE} --profile paper fast balanced accurate",
            "Eight other objects": f"{EVALUATE} bar,cone,cross,edge,plate,prism,ring,two_balls",
            "One reference, no press": f"{EVALUATE} {FIVE} --presses 0 --references 1",
        },
        r"^(Profiles|missed)$|\| Table I |^(?!mean)\w+ \| (paper|fast|balanced) |^(?!mean|cone)\w+ \| accurate \|",
    ),
    "drag": Page(
        {"": "tools.studies.drag --final"},
        r"^(frames|missed|refused|IoU|SD %|95 %)$|^\d.* \| (fast|balanced) |^[12] mm \|",
    ),
    "sigma": Page(
        {"": "tools.studies.sigma --final --objects large_crescent,cone,edge,ring"},
        r"^(Both families|frames|cells|error in the tenth of greatest σ %)$|^(0|1|2|2.75|4.5) mm ",
    ),
    "limits": Page(
        {
            "": "tools.studies.limits",
            "Which judge refuses a frame": "tools.studies.judges --frames 74",
        },
        r"^The limits of|^(silent ones|frames|invalid|degraded|lost|silently > 25 %|0\.(1|15|2|25|35|6) mm"
        r"|1\.5 mm|[12457] mm)$"
        r"|^pitch (1\.[46]|2|2\.[24])$|radius 9|^cylinder|half the dip|^ball, 90 %|^beyond.*(accurate|balanced)"
        r"|\| 0 \| 0\.00$|^(nothing|light|one side|warm-up|noise|after a)[^|]*\| (fast|balanced|accurate) "
        r"|saturated %|^(glare spot|after a release|dirty: specks|pressed) \| \d"
        r"|^(glare spot|moved by 1 px) \| \w+ \| 126|^not degraded$|^(nothing|light within|one side|warm-up"
        r"|moved by 1 px|noise of|pressed, |torn: (rows sideways by 200|one row|rows down|black)|black|white"
        r"|foreign: no skin|light x0)[^|]*\| \d+ \| ",
    ),
    "tradeoff": Page(
        {"": "tacshade_edge tradeoff --plot", "Three users": "tools.benchmarks.users"},
        r"^(networks|MiB|idle ms|fps, 4 fingers)$|^(contact|cloud|sigma|shear \| (fast|balanced)) \|"
        r"|^(# |profile:|source:|  )",
        idle=True,
        drawn=("tradeoff.png",),
        own=("tacshade_edge/studies",),
    ),
    "daemon": Page(
        {"": "tools.benchmarks.daemon --seconds 60 --runs 2"},
        r"^(captured|published|superseded|without_contact|unasked|invalid|failed|received|peak MB)$"
        r"|^(beside|contact, p50|free, p50) ",
        idle=True,
        own=("tacshade_edge/daemon",),
    ),
    "real-frames": Page(
        {
            "": f"{REAL} raw out/real/aerial_tactile_servoing",
            "Whole pictures, fitted to the reference": f"{REAL} raw out/real/aerial_tactile_servoing --fit",
            "Tilted and sheared plates": f"{REAL} plates out/real/tactile_data_shear",
            "Flat presses of stated depth": f"{REAL} flat out/real/TacTipFlexSim",
            "Raw pictures of tilted and sheared plates": f"{REAL} tilted out/real/tactile-manibot --frames 6425",
        },
        r"shear, no map|one offset|^(why|frames|of more than 0.3 mm)$|^(Published|References|Circle|fit of|Figures)"
        r"|^light \| light of |of 500 \||^(fast|balanced) \| (tilt|shear) ",
    ),
    "slip": Page(
        {"": "tools.studies.slip"},
        r"^(slips|early|never|deepest dent mm)$|^all |mm/s \| (fast|accurate) ",
    ),
    "servo": Page(
        {"": "tools.examples.servo.bench"},
        r"^(touches a second|their age, ms|frames not drawn)$|^\d+ \| (20|50) |^5 ",
        drawn=("servo.png",),
        own=("tools/examples/servo",),
    ),
    "fit": Page(
        {
            "": f"{FIT} 9028/none,other:9028/none,9029/none,other:9029/none",
            "With 40 presses": f"{FIT} 9028,other:9028,9029,other:9029",
            "What the fit knows": f"{FIT} 9027/drawing,other:9027/drawing,9027/exact,9027/slow,9027/steep",
        },
        r"^(ME after|The fit of all)|^(worst .*|6 mm deep (shipped|fitted)|IoU .*|file kB .*|start ms .*|.* worst"
        r"|SD % .*|frame ms .*|half of each.*|memory MB|fit s|kept|in 90 % .*)$"
        r"|^[^|]*\| fast \||^[^|]*(\d|/[^n]\w+) \| [+-]",
        own=("tacshade_edge/fitting",),
    ),
    "touch": Page(
        {
            "": "tools.studies.touch force out/real/tactile-manibot --profile accurate",
            "Thresholded frames of another robot": "tools.studies.touch plates out/real/tactile_data_shear"
            " --profile accurate --labels 4000 400 100",
        },
        r"^(Mean absolute|Published: )",
        drawn=("touch.png",),
    ),
    "arm": Page(
        {"": "tools.ci.run_arm --count-only"},
        r"^nothing failed$|no contact|^--- ",
        own=("tools/ci",),
    ),
    "faults": Page(
        {"": "tools.faults table"},
        r"^reported where$|^(recordings read|SIGTERM)",
        own=("tacshade_edge/daemon",),
    ),
}


def shrunk(printed: str, leave_out: str) -> str:
    """Drop lines, columns and rows that match a pattern; a table and the line above it go together."""
    blocks: list[str | None] = []
    dropped = re.compile(leave_out)
    for block in printed.split("\n\n"):
        lines = block.splitlines()
        if not block.startswith("|"):
            blocks.append("\n".join(line for line in lines if not dropped.search(line)) or None)
            continue
        rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
        rows[1] = [re.sub("-+", "---", cell) for cell in rows[1]]
        kept = [index for index, name in enumerate(rows[0]) if not dropped.search(name)]
        body = [row for row in rows[2:] if not dropped.search(" | ".join(row))]
        if blocks and blocks[-1] is None:
            blocks[-1] = ""
        elif body:
            blocks.append(
                "\n".join(
                    f"| {' | '.join(row[index] for index in kept)} |" for row in (*rows[:2], *body)
                )
            )
        elif blocks and not (blocks[-1] or "|").startswith("|"):
            blocks.pop()
    return "\n\n".join(block for block in blocks if block)


def git(*words: str) -> str:
    """Run git and return its output."""
    return subprocess.run(
        ["git", *words], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


def made_with(command: str, other: float) -> str:
    """Say how figures were made: by which command, commit and machine, beside how much other work."""
    code = ("--", ".", ":!docs", ":!*.md")
    commit = git("log", "-1", "--format=%h of %cs", *code)
    changed = " with uncommitted changes" if git("status", "--porcelain", *code) else ""
    names = re.findall(r"^model name\s*:\s*(.+)$", Path("/proc/cpuinfo").read_text(), re.MULTILINE)
    name = names[0].replace("(R)", "").replace(" Processor", "") if names else "unnamed processor"
    machine = f"{name}, {len(os.sched_getaffinity(0))} cores"
    return f"Made with `python -m {command}` at {commit}{changed} on {machine}; other work: {other:.2f}."


def worked_s() -> float:
    """Read the processor seconds of the whole machine, less those of this process's finished children."""
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
    """Run a page's commands and write the page; exit if a command fails or the machine is not idle."""
    file = FOLDER / f"{name}.md"
    parts = [
        re.split(
            r"^(?:Made with|## )", file.read_text(encoding="utf-8"), maxsplit=1, flags=re.MULTILINE
        )[0].strip()
    ]
    with tempfile.TemporaryDirectory() as out:
        for heading, command in page.commands.items():
            before, start = worked_s(), time.monotonic()
            drawing = ["--out", out] if page.drawn and not heading else []
            words = [sys.executable, "-m", *command.split(), *drawing]
            done = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False)
            # A benchmark that misses its own bar exits with 1, but has still measured.
            if done.returncode and (done.returncode != 1 or "|" not in done.stdout):
                sys.exit(f"{name}: {command}: exit code {done.returncode}")
            other = max(0.0, worked_s() - before) / (time.monotonic() - start)
            if page.idle and other > OTHER_LOAD:
                sys.exit(f"{name}: other programs took {other:.2f} cores meanwhile; not written")
            printed = shrunk(done.stdout.replace(f"{ROOT}/", "").strip(), page.leave_out)
            parts += [*([f"## {heading}"] if heading else []), made_with(command, other), printed]
        for picture in page.drawn:
            shutil.copy(Path(out) / picture, FOLDER / picture)
            parts.append(f"![{picture.removesuffix('.png').replace('_', ' ')}]({picture})")
    file.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def commits_of(name: str) -> list[str]:
    """List the commits that a page names, none for figures of uncommitted changes."""
    text = (FOLDER / f"{name}.md").read_text(encoding="utf-8")
    return re.findall(r"(?:at|code \|) ([0-9a-f]{7,40}) of [\d-]{10}(?! with uncommitted)", text)


def why_stale(name: str, page: Page) -> str:
    """Say why a page is stale; an empty string if it is not."""
    programs = {command.split()[0].replace(".", "/") for command in page.commands.values()} - {
        "tacshade_edge"
    }
    paths = ["tacshade_edge/core", "tacshade_edge/inference", *page.own]
    paths += [path if (ROOT / path).is_dir() else f"{path}.py" for path in programs]
    for commit in commits_of(name):
        if changes := git(
            "log", "--format=%h %s", f"{commit}..HEAD", "--", ":!*.md", *paths
        ).splitlines():
            return f"{len(changes)} commits since {commit}, the last {changes[0]}"
    return "" if commits_of(name) else "names no commit"


def main() -> None:
    """List the stale pages, or make those that are named."""
    names = sys.argv[1:]
    if unknown := sorted({*names} - {*PAGES}):
        sys.exit(f"{unknown[0]!r} is none of {', '.join(PAGES)}")
    for name in names:
        write(name, PAGES[name])
        print(f"{name} written", flush=True)
    if not names:
        stale = {name: why for name, page in PAGES.items() if (why := why_stale(name, page))}
        print("\n".join(f"{name:12} {why}" for name, why in stale.items()) or "no page is stale")


if __name__ == "__main__":
    main()
