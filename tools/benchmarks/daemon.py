"""Measure the daemon from frames to decoded height maps, next to a null daemon that only publishes.

::

    .venv/bin/python -m tools.benchmarks.daemon [--fps 60] [--seconds 20]
        [--runs 1] [--profile NAME] [--record]

Four processes: mosquitto on a loopback port, the daemon (`lab.trial.ring_daemon`) or the null
daemon (`null_daemon.py`), a subscriber that decodes (`lab.trial.hearing`), and this one, which
reads the daemon's figures from /proc. The frames are a ring of pre-drawn 640x480 grey images in
memory (not counted in the memory figures); the null daemon publishes the results of the same
images. In the rows

- ``contact`` a ball goes in and out, pressed from the first frame on,
  and the subscriber takes every topic;
- ``free`` nothing touches;
- ``unasked`` the ball goes in and out, and the subscriber takes only ``state`` and ``health``.

Latency runs from the frame's time stamp to the end of the subscriber's decode; both read the same
CLOCK_MONOTONIC. First map: from the start of the process to the end of the first decode. CPU: share
of one core over all threads, without the first seconds. With several runs the rows take turns, and
each figure is the best of its runs.

With ``--record`` the rows are the daemon without a recording, with a pre-roll of 10 s, and
recording to the folder for temporary files; the bench also prints what encoding a grey and a colour
frame costs.
"""

from __future__ import annotations

import argparse
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from support.mqtt_rig import Broker
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.doctor.tail import Tail, measure_tail
from tacshade_edge.lab.demo.demo_hand import make_calibration
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.lab.trial.hearing import Heard, HearingProcess, Listening
from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.caller import MqttCaller
from tacshade_edge.mqtt.client import broker_at
from tacshade_edge.recording.recorder import PNG_OPTIONS
from tacshade_edge.sensor.inference.network import make_reconstructor
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.settings import load
from tacshade_edge.types import Frame
from tacshade_edge.wire import binary
from tools.testbed.daemon_rig import cpu_s, draw_rings, memory_mb

RING_DAEMON, NULL_DAEMON = "tacshade_edge.lab.trial.ring_daemon", "tools.benchmarks.null_daemon"
OUTCOMES = ("published", "superseded", "without_contact", "unasked", "invalid", "failed")
LEAST_CPU = 0.001
"""Share of a core below which the kernel's ticks show nothing."""
SETTLE_S = 4.0  # start, first frames
KEPT = ("max_queued_messages 1000",)
"""The broker may lose nothing: every published map is counted."""
ROWS = {  # name: program, ring, the subscriber's topics
    "contact": (RING_DAEMON, "contact", "#"),
    "contact, null": (NULL_DAEMON, "contact", "#"),
    "free": (RING_DAEMON, "free", "#"),
    "free, null": (NULL_DAEMON, "free", "#"),
    "unasked": (RING_DAEMON, "contact", ""),
}
PRE_ROLL, RECORDING = "pre-roll", "recording"
RECORD_ROWS = dict.fromkeys(("contact", PRE_ROLL, RECORDING), ROWS["contact"])


def heard_of(heard: Heard) -> dict[str, Any]:
    """The figures of what the subscriber heard."""
    messages = heard.messages["bench"]
    found: dict[str, Any] = {
        "received": len(messages),
        "distinct": len({seq for _, seq, _, _ in messages}),
        "health": heard.health["bench"][-1][1],
    }
    if heard.ages_ms():
        found["first_ns"] = messages[0][3]
        parts = (("p50_ms", 0.5), ("p99_ms", 0.99), ("max_ms", 1.0))
        found |= {name: heard.percentile_ms(part) for name, part in parts}
    return found


def measure(
    name: str, row: tuple[str, str, str], folder: Path, port: int, args: argparse.Namespace
) -> dict[str, Any]:
    """One run of one daemon."""
    program, ring, topics = row
    listener = HearingProcess(
        Listening(
            broker=broker_at("127.0.0.1", port),
            sensors=["bench"],
            decoded=["height"] * bool(topics),
            received=[topics] * bool(topics),
        )
    )
    config, shown = (
        folder / ("pre_roll.yaml" if name == PRE_ROLL else "config.yaml"),
        folder / (f"{ring}.npy" if program == RING_DAEMON else f"{ring}.pickle"),
    )
    pause = threading.Event()
    began_s = time.monotonic()
    worker = subprocess.Popen([sys.executable, "-m", program, config, str(args.fps), shown])
    try:
        if name == RECORDING:
            record(config, args.seconds)
        pause.wait(began_s + SETTLE_S - time.monotonic())
        used_s, since_s = cpu_s(worker.pid), time.monotonic()
        pause.wait(began_s + args.seconds - since_s)
        cpu = (cpu_s(worker.pid) - used_s) / (time.monotonic() - since_s)
        memory = memory_mb(worker.pid)
        worker.send_signal(signal.SIGTERM)
        code = worker.wait(20)
        heard = heard_of(listener.heard())
    finally:
        worker.kill()
        listener.stop()
    frames = heard["health"]["frames"]
    accounted = code == 0 and frames["pending"] == 0
    accounted = accounted and frames["captured"] == sum(
        n for outcome, n in frames.items() if outcome != "captured"
    )
    if topics:
        accounted = accounted and heard["received"] == heard["distinct"] == frames["published"]
    if "first_ns" in heard:
        heard["first_map_s"] = heard["first_ns"] / 1e9 - began_s
    return {
        "cpu": cpu,
        "resident_mb": memory["resident"],
        "peak_mb": memory["peak"],
        **heard,
        "accounted": accounted,
    }


def record(config: Path, seconds: float) -> None:
    """Ask the daemon for a recording as soon as it runs; it ends a second before the run."""
    document, began_s = load(config), time.monotonic()
    caller = MqttCaller(
        links.broker_address(document),
        sensor_id=document.settings.sensor_id,
        verb="record",
        watched=("state",),
    )
    caller.start()
    if not caller.wait_for(lambda: caller.latest("state") == b"online", 20):
        raise SystemExit("daemon: the daemon does not come online")
    left_s = seconds - (time.monotonic() - began_s) - 1.0
    caller.ask({"action": "start", "name": RECORDING, "seconds": left_s}, 5)
    caller.stop()


def an_hour(folder: Path, recorded: dict[str, Any], fps: float) -> str:
    """A line with the disk space that an hour of recording takes."""
    files = [path.stat().st_size for path in folder.iterdir()]
    hour = sum(files) / recorded["written"] * fps * 3600 / 1e9
    return f"{folder.name}: {recorded}, {len(files)} files; an hour {hour:.1f} GB"


def encoding(folder: Path) -> str:
    """What the recorder's encoding of a frame costs, next to OpenCV's encoding at zlib level 1."""
    lines = []
    for what, ring in (("grey", "contact"), ("colour", "colour")):
        for name, options in (
            ("recorder", PNG_OPTIONS),
            ("zlib level 1", (cv2.IMWRITE_PNG_COMPRESSION, 1)),
        ):
            ms, sizes = [], []
            for image in np.load(folder / f"{ring}.npy"):
                began_s = time.thread_time()
                _, png = cv2.imencode(".png", image, options)
                ms.append(1e3 * (time.thread_time() - began_s))
                sizes.append(png.size)
            lines.append(f"{what}, {name}: {np.median(ms):.1f} ms, {np.median(sizes) / 1e3:.0f} kB")
    return "\n".join(lines)


def prepare(folder: Path, port: int, profile: str) -> None:
    """Write images, calibration and settings, and for the null daemon the real daemon's results
    for the images.
    """
    draw_rings(folder)
    calibration_file.save(folder / "c.npz", make_calibration())
    for file, pre_roll_s in (("config", 0), ("pre_roll", 10)):
        (folder / f"{file}.yaml").write_text(
            "sensor_id: bench\n"
            f"profile: {profile}\n"
            "calibration: c.npz\n"
            "source: {kind: simulated}\n"
            f"mqtt: {{host: 127.0.0.1, port: {port}}}\n"
            f"recorder: {{folder: recs, pre_roll_s: {pre_roll_s}}}\n"
        )
    calibration = calibration_file.load(folder / "c.npz")
    reconstructor, crc32 = make_reconstructor(calibration, PROFILES[profile]), calibration.crc32
    for ring in ("contact", "free"):
        made = [
            reconstructor.step(Frame(i, 0, 0, image))
            for i, image in enumerate(np.load(folder / f"{ring}.npy"))
        ]
        ready = [
            (
                binary.encode_height(r, calibration_crc32=crc32),
                binary.encode_cloud(r, calibration_crc32=crc32),
            )
            if r.contact
            else None
            for r in made
        ]
        (folder / f"{ring}.pickle").write_bytes(pickle.dumps(ready))


def best(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """The last run's counts with the minimum of every other figure."""
    figures = [name for name in runs[0] if name.endswith(("_ms", "_s", "_mb")) or name == "cpu"]
    least = {name: min(run[name] for run in runs) for name in figures}
    return {**runs[-1], **least, "accounted": all(run["accounted"] for run in runs)}


def table(results: dict[str, dict[str, Any]]) -> str:
    """The results as a Markdown table."""
    head = [
        "",
        "p50 ms",
        "p99 ms",
        "max ms",
        "first map s",
        "CPU core",
        "resident MB",
        "peak MB",
        "captured",
        *OUTCOMES,
    ]
    rows = []
    for name, r in results.items():
        timed = (("p50_ms", 1), ("p99_ms", 1), ("max_ms", 1), ("first_map_s", 2), ("cpu", 3))
        cells = [f"{r[key]:.{digits}f}" if key in r else "" for key, digits in timed]
        cells += [f"{r[key]:.0f}" for key in ("resident_mb", "peak_mb")]
        frames = r["health"]["frames"]
        counts = [frames["captured"], *(frames.get(o, 0) for o in OUTCOMES), r["received"]]
        rows.append([name, *cells, *map(str, counts), "yes" if r["accounted"] else "NO"])
    return markdown([*head, "received", "accounted"], rows)


def beside_null(results: dict[str, dict[str, Any]]) -> str:
    """What the daemon takes beyond the null daemon in the same rows."""
    contact, null, free = results["contact"], results["contact, null"], results["free"]
    p50, p99 = (contact[key] - null[key] for key in ("p50_ms", "p99_ms"))
    later_s = contact["first_map_s"] - null["first_map_s"]
    times = contact["cpu"] / max(null["cpu"], LEAST_CPU)
    free_null = max(results["free, null"]["cpu"], LEAST_CPU)
    free_times = free["cpu"] / free_null
    return (
        f"beside the null daemon: p50 {p50:+.1f} ms, p99 {p99:+.1f} ms, first map {later_s:+.2f} "
        f"s, CPU {times:.1f} times, without contact {free_times:.1f} times"
    )


def beside_control(contact: dict[str, Any], tail: Tail) -> str:
    """The tail of plain work that lasts as long as a frame in contact, and how much longer the
    daemon's is: what the control has too is the machine's.
    """
    return (
        f"control, plain products of {tail.processor_p50_ms:.1f} ms: p50 {tail.p50_ms:.1f} ms, "
        f"p99 {tail.p99_ms:.1f} ms, max {tail.worst_ms:.1f} ms; the daemon's p99 is "
        f"{contact['p99_ms'] / tail.p99_ms:.1f}, its max {contact['max_ms'] / tail.worst_ms:.1f} "
        "times the control's"
    )


def main() -> int:
    """Run the daemons one after the other; return 1 if a frame is not accounted for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run, start included")
    parser.add_argument(
        "--runs", type=int, default=1, help="of each row; its best figures are printed"
    )
    parser.add_argument("--profile", choices=list(PROFILES), default=DEFAULT)
    parser.add_argument(
        "--record", action="store_true", help="the daemon without and with a recording"
    )
    args = parser.parse_args()
    if args.seconds < SETTLE_S + 1:
        parser.error(f"--seconds: expected {SETTLE_S + 1:.0f} or more")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows, hours = RECORD_ROWS if args.record else ROWS, list[str]()
        runs: dict[str, list[dict[str, Any]]] = {row: [] for row in rows}
        with Broker(folder, more=KEPT) as broker:
            prepare(folder, broker.port, args.profile)
            for _ in range(args.runs):
                for row, what in rows.items():
                    shutil.rmtree(folder / "recs", ignore_errors=True)
                    runs[row].append(measure(row, what, folder, broker.port, args))
                    if row == RECORDING:
                        recorded = runs[row][-1]["health"]["recorder"]
                        hours.append(an_hour(folder / "recs" / RECORDING, recorded, args.fps))
        encoded = encoding(folder) if args.record else ""
    results = {row: best(made) for row, made in runs.items()}
    print(table(results))
    if not args.record:
        print(beside_null(results))
        contact = results["contact"]
        frame_ms = 1e3 * max(contact["cpu"], LEAST_CPU) / args.fps
        print(beside_control(contact, measure_tail(frame_ms, args.fps, args.seconds)))
    for row in [row for row in results if row == "free" or row == "contact"]:
        stages = results[row]["health"]["stages_ms"]
        print(
            f"{row}, p50 / p99 ms: "
            + ", ".join(f"{stage} {s['p50']} / {s['p99']}" for stage, s in stages.items())
        )
    if args.record:
        print("\n".join((*hours, encoded)))
    return 0 if all(r["accounted"] for r in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
