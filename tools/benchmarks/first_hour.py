"""The first hour of a new user who follows the documents: from a fresh clone to a calibrated simulated sensor.

::

    .venv/bin/python -m tools.benchmarks.first_hour

It takes the commands from README.md ("Get it") and calibration.md ("Practise without a sensor"), runs them in a
temporary folder with this clone in place of the repository's address, answers `capture` as the page says, presses
eight times, and prints how long each step took. It stops at the first command that fails.
"""

from __future__ import annotations

import os
import re
import subprocess
import tempfile
import time
from pathlib import Path

from tools.testbed.person import person

ROOT = Path(__file__).parents[2]
# Ball radius, depth, x and y, mm.
PRESSES = (
    *((6, 2.5, 1, -3), (3, 1.5, -5, 2), (9, 3, 5, 5), (6, 1, -6, -6)),
    *((4.5, 2, 0, 7), (6, 3, 7, 0), (3, 2, -7, 0), (9, 1.5, 0, 0)),
)


def blocks(page: str, heading: str) -> list[str]:
    """The indented blocks of commands under a heading."""
    text = (ROOT / page).read_text().partition(f"## {heading}\n")[2].partition("\n## ")[0]
    return [
        re.sub(r"^    ", "", block, flags=re.MULTILINE) for block in re.findall(r"(?:^    .*\n)+", text, re.MULTILINE)
    ]


def shell(text: str, folder: Path) -> None:
    """Run commands as typed, in one shell. Raises CalledProcessError if one fails."""
    subprocess.run(["bash", "-ec", text], cwd=folder, check=True, stdout=subprocess.DEVNULL)


def practise(begin: str, press: str, python: Path, folder: Path) -> str:
    """Run `capture` with a file in place of the hand; return the command that it prints last."""
    *files, capture = begin.strip().splitlines()
    shell("\n".join(files), folder)
    answers = re.search(r"`(\S+)`, `(\S+)`, `(\S+)`, `(\S+)`", (ROOT / "docs/how-to/calibration.md").read_text())
    assert answers
    with person(*capture.split()[2:], python=str(python), folder=folder) as one:
        questions = ("Radius of", "Half angle", "Distance of the lens", "Does a press")
        for question, answer in zip(questions, answers.groups(), strict=True):
            one.hears(question)
            one.types(answer)
        one.hears("Enter takes 10 references")
        one.types("")
        one.hears("10 references, noise")
        for k, numbers in enumerate(PRESSES, 1):
            one.hears(f"press {k} (")
            shell(press.replace("6,2.5,1,-3", ",".join(map(str, numbers))), folder)
            one.types(f"ball {' '.join(map(str, numbers))}")
            one.hears(f"press_{k:03d}.png")
        one.hears("press 9 (")
        one.types("done")
        one.hears("next:")
        assert one.ends() == 0
        return one.heard.splitlines()[1].strip()


def main() -> None:
    """Print a line for each step."""
    with tempfile.TemporaryDirectory() as made:
        folder, began_s = Path(made), time.monotonic()
        empty = folder / "practice"
        empty.mkdir()

        def say(what: str) -> None:
            print(f"{time.monotonic() - began_s:5.0f} s  {what}", flush=True)

        (get_it,) = blocks("README.md", "Get it")
        shell(get_it.replace("git clone ...", f"git clone {ROOT}"), folder)
        programs = folder / "tacshade-edge" / "env" / "bin"
        os.environ["PATH"] = f"{programs}:{os.environ['PATH']}"
        say("cloned and installed")
        begin, press, at_once = blocks("docs/how-to/calibration.md", "Practise without a sensor")
        following = practise(begin, press, programs / "python", empty)
        say(f"references and {len(PRESSES)} presses taken")
        shell(following, empty)
        say("calibrated")
        shell(at_once, empty)
        shell(following.replace("mysensor", "practice"), empty)
        say("forty presses at once, and calibrated")


if __name__ == "__main__":
    main()
