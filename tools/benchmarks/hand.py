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
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from support.mqtt_rig import Broker
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.sensor.profiles import DEFAULT, PROFILES
from tacshade_edge.wire import binary
from tacshade_edge.wire.hand_topics import HandObjects
from tacshade_edge.wire.topics import decode_contact, decode_hand
from tools.benchmarks.daemon import KEPT, NULL_DAEMON, RING_DAEMON, SETTLE_S, prepare
from tools.testbed.daemon_rig import cpu_s, pss_mb

PRESSED = 2
TOPICS = ("height", "cloud", "contact")
HAND_ID = "bench"
ROWS = ("hand", "objects", "apart", "null")


def subscriber(port: int, names: list[str], topics: list[str]) -> None:
    """Decode each message of the first topic; print latencies in ms
    and the last counts once all have stopped.
    """
    latencies: dict[str, list[float]] = {name: [] for name in names}
    health: dict[str, Any] = {}
    own_ns: dict[tuple[str, int | None], int] = {}
    messages: list[tuple[int, HandObjects]] = []
    left, done = set(names), threading.Event()

    def on_message(_client: Client, _data: None, message: MQTTMessage) -> None:
        name, topic = message.topic.split("/")[-2:]
        if message.retain:
            return
        if topic == "objects":
            hand = decode_hand(bytes(message.payload))
            messages.append((time.monotonic_ns(), hand))
        elif topic == topics[0]:
            frame = (
                decode_contact(bytes(message.payload))
                if topic == "contact"
                else binary.decode(message.payload)
            )
            own_ns[name, frame.seq] = now_ns = time.monotonic_ns()
            latencies[name].append((now_ns - frame.t_ns) / 1e6)
        elif topic == "health":
            known = json.loads(message.payload)
            health[name] = known["frames"] | {"lost": known.get("source_dropped", 0)}
        elif topic == "state" and message.payload in (b"stopped", b"offline"):
            left.discard(name)
            if not left:
                done.set()

    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = on_message
    client.on_subscribe = lambda *_: print("ready", flush=True)
    client.connect("127.0.0.1", port)
    wanted = [f"{name}/{topic}" for name in names for topic in (*topics, "health", "state")]
    client.subscribe([(f"tacshade/{topic}", 1) for topic in (*wanted, f"hand/{HAND_ID}/objects")])
    client.loop_start()
    done.wait()
    client.disconnect()
    client.loop_stop()
    ages_ms, later_ms = ages(messages, own_ns)
    rate = 1e9 * len(own_ns) / max(max(own_ns.values()) - min(own_ns.values()), 1) / len(names)
    figures = {"objects_ms": ages_ms, "later_ms": later_ms, "messages": len(messages), "rate": rate}
    print(json.dumps({"latencies": latencies, "health": health, **figures}))


def ages(
    messages: list[tuple[int, HandObjects]], own_ns: dict[tuple[str, int | None], int]
) -> tuple[list[float], list[float]]:
    """Age in ms of the newest frame in each of the hand's messages,
    unless an earlier message already had it.

    `messages` have their decode time (CLOCK_MONOTONIC ns), `own_ns` that of the finger's own height
    map by finger and frame. The second list is the time since that, where there is one.
    """
    ages_ms, later_ms, latest_ns = list[float](), list[float](), 0
    for at_ns, hand in messages:
        touching = [
            (f.t_ns, name, f.seq)
            for name, f in hand.fingers.items()
            if f.state == "contact" and f.t_ns
        ]
        t_ns, name, seq = max(touching, default=(0, "", None))
        if t_ns > latest_ns:
            latest_ns = t_ns
            ages_ms.append((at_ns - t_ns) / 1e6)
            if (name, seq) in own_ns:
                later_ms.append((at_ns - own_ns[name, seq]) / 1e6)
    return ages_ms, later_ms


def family(pid: int) -> list[int]:
    """Ids of a process and its children."""
    found = subprocess.run(("pgrep", "-P", str(pid)), capture_output=True, check=False).stdout
    return [pid, *map(int, found.split())]


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
    words = [
        sys.executable,
        "-m",
        "tools.benchmarks.hand",
        "--role",
        ",".join(names),
        "--port",
        str(port),
    ]
    words += ["--topics", ",".join(topics)]
    listen = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    assert listen.stdout is not None
    assert listen.stdout.readline() == "ready\n"
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
        heard = json.loads(listen.communicate(timeout=30)[0])
    finally:
        for worker in workers:
            worker.kill()
        listen.kill()
    frames = heard["health"]
    accounted = not any(codes) and len(frames) == len(names)
    for name in names:
        counts = frames[name]
        accounted &= counts["pending"] == 0
        accounted &= counts["captured"] == sum(
            n for outcome, n in counts.items() if outcome not in ("captured", "lost")
        )
        accounted &= topics[0] != "height" or len(heard["latencies"][name]) == counts["published"]
    steady = sorted(
        ms for each in heard["latencies"].values() for ms in each[round(2 * args.fps) :]
    )
    of = {f"p{p}_ms": steady[int(len(steady) * p / 100)] for p in (50, 99)}
    captured = sum(counts["captured"] for counts in frames.values())
    lost = sum(
        counts[why] for counts in frames.values() for why in ("superseded", "failed", "lost")
    )
    found = {
        "lost": lost,
        "rate": heard["rate"],
        "memory_mb": memory,
        "cpu": cpu,
        **of,
        "max_ms": steady[-1],
        "captured": captured,
        "accounted": accounted,
    }
    if row == "objects":
        for what in ("objects", "later"):
            times_ms = sorted(heard[f"{what}_ms"][round(2 * args.fps) :])
            found |= {f"{what}_p{p}_ms": times_ms[int(len(times_ms) * p / 100)] for p in (50, 99)}
        found["objects_per_s"] = heard["messages"] / args.seconds
    return found


def main() -> int:
    """Run the rows one after the other; return 1 if a frame is not accounted for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sensors", type=int, default=5)
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each row, start included")
    parser.add_argument("--profile", choices=list(PROFILES), default=DEFAULT)
    for hidden, kind in (("--role", str), ("--port", int), ("--topics", str)):  # for the subscriber
        parser.add_argument(hidden, type=kind, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role is not None:
        subscriber(args.port, args.role.split(","), args.topics.split(","))
        return 0
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
