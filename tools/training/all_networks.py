#!/usr/bin/env python3
"""Make the data and train all networks at the same time,
on a GPU while the processor makes the data.

::

    .venv-train/bin/python -m tools.training.all_networks --data DATA --out RUNS
        --device cuda --minutes 12

After an interruption, run it again to continue.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

NETWORKS = {
    "accurate": ("--widths", "16", "32", "48", "128"),
    "balanced": ("--fold", "4", "--widths", "16", "32", "48"),
    "fast": ("--cells", "56", "--fold", "4", "--widths", "32", "48"),
    "shear": ("--net", "shear"),
}
"""The arguments of `train.py` that give each network its shape."""


def main() -> None:
    """Start the processes and wait until the networks are trained."""
    parser = argparse.ArgumentParser(description="Make the data and train all networks.")
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="folder for a run of each network")
    parser.add_argument("--sensors", default="10000")
    parser.add_argument("--networks", nargs="+", choices=NETWORKS, default=list(NETWORKS))
    args, others = parser.parse_known_args()
    module = (sys.executable, "-m")
    maker = subprocess.Popen(
        (*module, "tools.training.make_data", "--out", args.data, "--sensors", args.sensors)
    )
    runs = [
        subprocess.Popen(
            (
                *module,
                "tools.training.train",
                "--data",
                args.data,
                "--out",
                args.out / name,
                *NETWORKS[name],
                *others,
            )
        )
        for name in args.networks
    ]
    failed = [name for name, run in zip(args.networks, runs, strict=True) if run.wait()]
    maker.terminate()
    raise SystemExit(f"training failed: {', '.join(failed)}" if failed else 0)


if __name__ == "__main__":
    main()
