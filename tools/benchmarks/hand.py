"""Measure a hand: several sensors in one command, next to as many null daemons that only publish.

::

    .venv/bin/python -m tools.benchmarks.hand [--sensors 5] [--fps 60] [--seconds 20]
        [--profile NAME]

It uses the ring of images, the null daemon and the broker of ``tools.benchmarks.daemon``: two of
the sensors are pressed, nothing touches the others, and one subscriber takes ``TOPICS`` of all. In
the rows

- ``hand`` is ``run`` with one file for all sensors: a process for each, forked from one;
- ``objects`` is the same with a ``hand_id``: one more process, and the subscriber takes its
  topic too;
- ``apart`` is one command ``run`` for each sensor, with its own file, as under a template unit;
- ``null`` is as many null daemons.

Memory is the proportional set size (PSS) of all processes of a row, without the images that replace
the camera: a page that five share is counted once. CPU is the sum over all processes as a share of
one core, without the first seconds. For the hand's topic the bench reports the messages per second,
the age of each message's newest frame when the message was decoded, and how much later that was
than the decode of the finger's own height map of the same frame.
"""

from __future__ import annotations

import argparse
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from support.mqtt_rig import Broker
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.lab.trial.hearing import Heard, HearingProcess, Listening
from tacshade_edge.mqtt.client import broker_at
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tools.benchmarks.daemon import KEPT, NULL_DAEMON, RING_DAEMON, SETTLE_S, prepare
from tools.testbed.daemon_rig import cpu_s, family, pss_mb

PRESSED = 2
TOPICS = ("height", "cloud", "contact")
HAND_ID = "bench"
ROWS = ("hand", "objects", "apart", "null")


def ages(heard: Heard) -> tuple[list[float], list[float]]:
    """Age in ms of the newest frame in each of the hand's messages,
    unless an earlier message already had it.

    The second list is the time since the decode of the finger's own message of the same frame,
    where there is one.
    """
    own_ns = {
        (name, seq): at_ns for name, some in heard.messages.items() for _, seq, _, at_ns in some
    }
    ages_ms, later_ms, latest_ns = list[float](), list[float](), 0
    for at_ns, touching in heard.hand:
        t_ns, name, seq = max(touching, default=(0, "", None))
        if t_ns > latest_ns:
            latest_ns = t_ns
            ages_ms.append((at_ns - t_ns) / 1e6)
            if seq is not None and (name, seq) in own_ns:
                later_ms.append((at_ns - own_ns[name, seq]) / 1e6)
    return ages_ms, later_ms


def measure(
    row: str,
    folder: Path,
    port: int,
    names: list[str],
    args: argparse.Namespace,
    pressed: int,
    topics: Sequence[str],
) -> dict[str, Any]:
    """Run one row's daemons for the given seconds and return the figures;
    the latencies are the first topic's.
    """
    listener = HearingProcess(
        Listening(
            broker=broker_at("127.0.0.1", port),
            sensors=names,
            decoded=topics[:1],
            received=topics[1:],
            hand_id=HAND_ID,
        )
    )
    kinds = ["contact" if k < pressed else "free" for k in range(len(names))]
    rings = [str(folder / f"{kind}.npy") for kind in kinds]
    if row not in ("apart", "null"):
        commands = [
            [sys.executable, "-m", RING_DAEMON, str(folder / f"{row}.yaml"), str(args.fps), *rings]
        ]
    else:
        program, ending = (RING_DAEMON, "npy") if row == "apart" else (NULL_DAEMON, "pickle")
        commands = [
            [
                sys.executable,
                "-m",
                program,
                str(folder / f"{name}.yaml"),
                str(args.fps),
                f"{folder}/{kind}.{ending}",
            ]
            for name, kind in zip(names, kinds, strict=True)
        ]
    began_s, pause = time.monotonic(), threading.Event()
    workers = [subprocess.Popen(command) for command in commands]
    try:
        pause.wait(began_s + SETTLE_S - time.monotonic())
        pids = [pid for worker in workers for pid in family(worker.pid)]
        used_s, since_s = sum(map(cpu_s, pids)), time.monotonic()
        pause.wait(began_s + args.seconds - since_s)
        cpu = (sum(map(cpu_s, pids)) - used_s) / (time.monotonic() - since_s)
        memory = sum(
            pss_mb(pid) for worker in workers for pid in family(worker.pid)
        )  # some may have been forked since
        for worker in workers:
            worker.send_signal(signal.SIGTERM)
        codes = [worker.wait(30) for worker in workers]
        heard = listener.heard()
    finally:
        for worker in workers:
            worker.kill()
        listener.stop()
    frames = {name: told[-1][1]["frames"] for name, told in heard.health.items()}
    accounted = not any(codes) and len(frames) == len(names)
    for name in names:
        counts = frames[name]
        accounted &= counts["pending"] == 0
        accounted &= counts["captured"] == sum(
            n for outcome, n in counts.items() if outcome != "captured"
        )
        accounted &= topics[0] != "height" or len(heard.messages[name]) == counts["published"]
    captured = sum(counts["captured"] for counts in frames.values())
    found = {
        "lost": heard.frames()[1],
        "rate": heard.rate(),
        "memory_mb": memory,
        "cpu": cpu,
        "p50_ms": heard.percentile_ms(0.5),
        "p99_ms": heard.percentile_ms(0.99),
        "max_ms": heard.percentile_ms(1.0),
        "captured": captured,
        "accounted": accounted,
    }
    if row == "objects":
        for what, each in zip(("objects", "later"), ages(heard), strict=True):
            times_ms = sorted(each[round(2 * args.fps) :])
            found |= {f"{what}_p{p}_ms": times_ms[int(len(times_ms) * p / 100)] for p in (50, 99)}
        found["objects_per_s"] = len(heard.hand) / args.seconds
    return found


def main() -> int:
    """Run the rows one after the other; return 1 if a frame is not accounted for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensors", type=int, default=5)
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each row, start included")
    parser.add_argument("--profile", choices=list(PROFILES), default=DEFAULT)
    args = parser.parse_args()
    names = [f"finger{k}" for k in range(args.sensors)]
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        with Broker(folder, more=KEPT) as broker:
            prepare(folder, broker.port, args.profile)
            text, calibration = (
                (folder / "config.yaml").read_text(),
                (folder / "c.npz").read_bytes(),
            )
            sensors, fingers = [], []
            for k, name in enumerate(names):
                (folder / f"{name}.npz").write_bytes(calibration)
                own = (
                    text.replace("bench", name)
                    .replace("c.npz", f"{name}.npz")
                    .replace("folder: recs", f"folder: {name}")
                )
                (folder / f"{name}.yaml").write_text(f"{own}stitching: {{folder: {name}-maps}}\n")
                own = f"calibration: {name}.npz, source: {{kind: simulated}}"
                sensors.append(f"  {name}: {{{own}}}\n")
                fingers.append(
                    f"  {name}: {{{own}, hand_T_sensor: [{40 * k}, 0, 90, 1, 0, 0, 0]}}\n"
                )
            common = f"profile: {args.profile}\nmqtt: {{host: 127.0.0.1, port: {broker.port}}}\n"
            common += "recorder: {folder: recs}\nstitching: {folder: maps}\n"
            (folder / "hand.yaml").write_text(f"{common}sensors:\n{''.join(sensors)}")
            (folder / "objects.yaml").write_text(
                f"{common}hand_id: {HAND_ID}\nsensors:\n{''.join(fingers)}"
            )
            results = {
                row: measure(row, folder, broker.port, names, args, PRESSED, TOPICS) for row in ROWS
            }
    head = ["", "memory MB", "CPU cores", "p50 ms", "p99 ms", "max ms", "captured", "accounted"]
    rows = [
        [
            row,
            f"{r['memory_mb']:.0f}",
            f"{r['cpu']:.2f}",
            *(f"{r[key]:.1f}" for key in ("p50_ms", "p99_ms", "max_ms")),
            str(r["captured"]),
            "yes" if r["accounted"] else "NO",
        ]
        for row, r in results.items()
    ]
    print(markdown(head, rows))
    found = results["objects"]
    print(
        "\n"
        f"objects: {found['objects_per_s']:.0f} messages/s, the newest frame "
        f"{found['objects_p50_ms']:.1f} ms (p50), {found['objects_p99_ms']:.1f} ms (p99) old, "
        f"later than in its finger's own message by {found['later_p50_ms']:.1f} ms (p50), "
        f"{found['later_p99_ms']:.1f} ms (p99)"
    )
    return 0 if all(r["accounted"] for r in results.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
