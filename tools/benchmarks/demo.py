"""How long a newcomer waits after `make demo` in a fresh clone for the first height map and the first that moves.

    python -m tools.benchmarks.demo [--cold]

It runs twice in the same clone: with the installs, and without. --cold: with an empty pip cache, as on a fresh machine.
Prints seconds from the start of `make demo`, and how long Ctrl-C takes.
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from tools.testbed.page_client import PageClient

ROOT = Path(__file__).parents[2]


def once(clone: Path, environment: dict[str, str]) -> tuple[float, float, float, float]:
    """Seconds to the address, to the first height map and to the first different one; seconds that Ctrl-C takes."""
    begin = time.monotonic()
    process = subprocess.Popen(
        ["make", "demo"], cwd=clone, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
    )
    assert process.stdout is not None
    found = None
    while found is None:
        line = process.stdout.readline()
        if not line:
            raise SystemExit(f"make demo ended with {process.wait()}")
        found = re.search(r"open http://127\.0\.0\.1:(\d+)/", line)
    address_s = time.monotonic() - begin
    first_s = moving_s = None
    with PageClient(int(found[1])) as page:
        while moving_s is None:
            depths = {float(np.nanmax(height.height_mm)) for height in page.heights()}
            if depths and first_s is None:
                first_s = time.monotonic() - begin
            if len(depths) > 1:
                moving_s = time.monotonic() - begin
            time.sleep(0.02)
    stop = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    process.communicate()
    assert first_s is not None
    return address_s, first_s, moving_s, time.monotonic() - stop


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cold", action="store_true", help="with an empty pip cache")
    cold = parser.parse_args().cold
    with tempfile.TemporaryDirectory() as folder:
        clone = Path(folder) / "clone"
        subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
        environment = {**os.environ, **({"PIP_CACHE_DIR": str(Path(folder) / "cache")} if cold else {})}
        print("                     address  first map  moving  Ctrl-C   (seconds)")
        for name in ("with the installs", "after"):
            address_s, first_s, moving_s, stop_s = once(clone, environment)
            print(f"{name:<20} {address_s:7.1f} {first_s:10.1f} {moving_s:7.1f} {stop_s:7.1f}", flush=True)


if __name__ == "__main__":
    main()
