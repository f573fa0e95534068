"""Measure the dashboard: height maps published, delivered and drawn by a headless browser.

::

    .venv/bin/python -m tools.benchmarks.dashboard [--fps 30] [--step 1] [--seconds 10] [--json]

Five processes: mosquitto, a publisher of synthetic maps with their clouds, the dashboard, Chromium with its driver, and
this one. With ``--step 1`` a map is 640x480 cells (614 KB), with 4 it is 160x120 (38 KB; the daemon sends 112x112).
The page counts the distinct maps that it drew on the canvas; the age runs from a map's time stamp until it was drawn,
by one clock. A map is superseded if a newer one replaced it in the page; a received map that is neither is
unaccounted. Chromium runs without a graphics card: it draws in software on the same cores.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import multiprocessing
import os
import statistics
import tempfile
import threading
import time
import zlib
from multiprocessing.synchronize import Event
from pathlib import Path
from typing import Any

import numpy as np

from tacshade_edge.protocol import wire
from tools.testbed.browser import browser, errors
from tools.testbed.dashboard_process import dashboard
from tools.testbed.mqtt_rig import Broker
from tools.testbed.patience import wait_until
from tools.testbed.published_sensor import CRC, PublishedSensor, bump

RING = 16


def publish(port: int, fps: float, step_px: int, stop: Event) -> None:
    """Publish a press that goes in and out at a steady rate; skip late frames."""
    ring = [bump(0, 0.2 + 2.5 * k / RING, 236.0, 270.0 + 8 * k, step_px) for k in range(RING)]
    with PublishedSensor(port) as sensor:
        began, seq = time.monotonic(), 0
        while not stop.is_set():
            seq = max(seq + 1, int((time.monotonic() - began) * fps))
            time.sleep(max(0.0, began + seq / fps - time.monotonic()))
            t_ns, wall_ns = time.monotonic_ns(), time.time_ns()
            sensor.show(dataclasses.replace(ring[seq % RING], seq=seq, t_ns=t_ns, wall_ns=wall_ns))


def cpu_s(pid: int) -> float:
    """User and system time of a process so far, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def child_of(parent: int, word: str) -> int:
    """Id of the child process with this word in its command."""
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            command, stat = (entry / "cmdline").read_bytes().decode(), (entry / "stat").read_text()
        except OSError:
            continue
        if word in command.split("\0") and int(stat.rpartition(")")[2].split()[1]) == parent:
            return int(entry.name)
    raise LookupError(word)


def deflated(step_px: int) -> dict[str, float]:
    """Size and time of a map under permessage-deflate as the websockets package sets it up."""
    rng = np.random.default_rng(1)
    result = bump(1, 2.5, 236.0, 300.0, step_px)
    noisy = result.height.height_mm + rng.normal(0, 0.004, result.height.height_mm.shape).astype(np.float32)
    height = dataclasses.replace(result.height, height_mm=noisy)
    payload = wire.encode_height(dataclasses.replace(result, height=height), calibration_crc32=CRC)
    began = time.process_time()
    compressor = zlib.compressobj(wbits=-12, memLevel=5)
    size = len(compressor.compress(payload)) + len(compressor.flush(zlib.Z_SYNC_FLUSH))
    return {
        "deflate_ms": round(1000 * (time.process_time() - began), 1),
        "deflate_ratio": round(size / len(payload), 2),
        "map_bytes": len(payload),
    }


def measure(fps: float, step_px: int, seconds: float) -> dict[str, Any]:
    """Run every process in a temporary folder and return the figures."""
    stop = multiprocessing.Event()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with Broker(folder) as broker, dashboard(f"127.0.0.1:{broker.port}") as address:
            server = child_of(os.getpid(), "dashboard")
            publisher = multiprocessing.Process(target=publish, args=(broker.port, fps, step_px, stop))
            publisher.start()
            try:
                with browser(folder / "chromium") as page:
                    page.get(address)
                    state = (
                        "const t = window.tacshade, m = t && t.maps;"
                        "return t ? [m.drawn, t.seq, t.age_ms, t.undecodable, m.heard, m.superseded, m.waiting] : [0]"
                    )
                    wait_until(lambda: page.execute_script(state)[0] > 20, 60, "maps are drawn")
                    first, began, busy = page.execute_script(state), time.monotonic(), cpu_s(server)
                    ages, pause = [], threading.Event()
                    while time.monotonic() - began < seconds:
                        pause.wait(0.2)
                        ages.append(page.execute_script(state)[2])
                    last, took_s = page.execute_script(state), time.monotonic() - began
                    return {
                        "published_per_s": round((last[1] - first[1]) / took_s, 2),
                        "drawn_per_s": round((last[0] - first[0]) / took_s, 2),
                        "heard_per_s": round((last[4] - first[4]) / took_s, 2),
                        "superseded": last[5] - first[5],
                        "unaccounted": last[4] - last[0] - last[5] - last[6],
                        "age_ms": {"p50": round(statistics.median(ages), 1), "max": max(ages)},
                        "server_cpu_ratio": round((cpu_s(server) - busy) / took_s, 3),
                        "undecodable": last[3],
                        "console_errors": errors(page),
                        **deflated(step_px),
                    }
            finally:
                stop.set()
                publisher.join(10)


def main() -> None:
    """Parse the options, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fps", type=float, default=30.0)
    parser.add_argument("--step", type=int, default=1, choices=(1, 2, 4), help="pixels per cell")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", action="store_true", help="one line of JSON")
    args = parser.parse_args()
    figures = measure(args.fps, args.step, args.seconds)
    if args.json:
        print(json.dumps(figures))
    else:
        for key, value in figures.items():
            print(f"{key:18} {value}")


if __name__ == "__main__":
    main()
