"""What `tradeoff` recommends to three users, and what the daemon then does.

::

    .venv/bin/python -m tools.benchmarks.users [--seconds 60]

For each user, `tradeoff` prints the settings, and a daemon runs with them: every finger has a ring
of images in memory, in which a ball goes in and out, and a subscriber decodes. Promised is what the
daemon showed in the seconds that `tradeoff` tried it; measured is the age of the decoded height
map, or `contact`, in a longer run. The control is plain work that takes as long as a frame, at the
same rate: on a machine that does other work, promises hold in ratio to it. Lost frames, of those
after the first second, are superseded, failed, or dropped by the source; `hand.py` describes CPU
and memory.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml

from support.mqtt_rig import Broker
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.doctor.tail import measure_tail
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.image.preprocess import halved_calibration, halved_image
from tools.benchmarks.daemon import KEPT, prepare
from tools.benchmarks.hand import measure

USERS = {  # name: fingers, frames per second, outputs, topics
    "everything": (1, 60, "", ("height", "cloud", "contact", "shear", "sigma", "touch", "event/#")),
    "hand": (5, 30, "height,shear", ("height", "shear")),
    "logger": (1, 10, "contact", ("contact",)),
}


def recommended(user: str) -> str:
    """The block that `tradeoff` prints for a user."""
    fingers, fps, outputs, _ = USERS[user]
    words = [
        "--fingers",
        str(fingers),
        "--fps",
        str(fps),
        *(["--outputs", outputs] if outputs else []),
    ]
    command = [sys.executable, "-m", "tacshade_edge", "tradeoff", *words]
    printed = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()
    return printed[printed.rindex("\n\n") :].strip()


def run(user: str, block: str, folder: Path, port: int, args: argparse.Namespace) -> list[str]:
    """Run the daemon with a user's settings; return the row of the table."""
    fingers, args.fps, outputs, topics = USERS[user]
    said = re.search(r"^# (\w+ at \S+): .*, at most (\d+) frames/s$", block, re.MULTILINE)
    promised = re.search(r"\(p50\), (\S+) ms \(p99\)", block)
    control = re.search(r"plain work of (\S+) ms ends within (\S+) ms", block)
    assert said
    assert promised
    assert control
    prepare(folder, port, profile := yaml.safe_load(block)["profile"])
    if half := "height_px" in block:
        np.save(
            folder / "contact.npy",
            np.stack(list(map(halved_image, np.load(folder / "contact.npy")))),
        )
    calibration = calibration_file.load(folder / "c.npz")
    names = [f"{user}{k}" for k in range(fingers)]
    for name in names:
        calibration_file.save(
            folder / f"{name}.npz", halved_calibration(calibration) if half else calibration
        )
    text = f"profile: {profile}\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
    if fingers == 1:
        text += f"sensor_id: {names[0]}\ncalibration: {names[0]}.npz\nsource: {{kind: simulated}}\n"
    else:
        own = (
            f"  {name}: {{calibration: {name}.npz, source: {{kind: simulated}}}}\n"
            for name in names
        )
        text += "sensors:\n" + "".join(own)
    (folder / f"{user}.yaml").write_text(text)
    found = measure(user, folder, port, names, args, fingers, topics)
    beside = measure_tail(float(control[1]), args.fps, args.seconds / 4)
    times = found["p99_ms"] / float(promised[1])
    in_ratio = times / (beside.p99_ms / float(control[2]))
    figures = [f"{found[key]:.1f}" for key in ("rate", "p50_ms", "p99_ms")]
    figures += [f"{times:.2f}", f"{in_ratio:.2f}"]
    figures += [str(found["lost"]), f"{found['cpu']:.2f}", f"{found['memory_mb']:.0f}"]
    wanted = f"{fingers} x {args.fps}/s, {outputs or 'everything'}"
    return [wanted, said[1], promised[1], said[2], *figures]


def main() -> None:
    """Ask, run and print, one user after the other."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--seconds", type=float, default=60.0, help="of each daemon, start included"
    )
    args = parser.parse_args()
    blocks = {user: recommended(user) for user in USERS}
    with tempfile.TemporaryDirectory() as name, Broker(Path(name), more=KEPT) as broker:
        rows = [run(user, block, Path(name), broker.port, args) for user, block in blocks.items()]
    head = ["wanted", "settings", "promised p99 ms", "frames/s"]
    head += ["measured frames/s", "p50 ms", "p99 ms", "times promised", "in ratio to control"]
    head += ["lost", "CPU cores", "memory MB"]
    settings = [f"```yaml\n{block.strip()}\n```" for block in blocks.values()]
    print(markdown(head, rows), *settings, sep="\n\n")


if __name__ == "__main__":
    main()
