"""Measure the daemon: frames in, decoded height maps at a subscriber, beside a null daemon that only publishes.

::

    .venv/bin/python tools/bench_daemon.py [--fps 60] [--seconds 20] [--profile fast] [--record] [--json FILE]

Four processes: mosquitto on a loopback port, the daemon (or the null daemon), a subscriber that decodes, and this
one. The frames are a ring of pre-rendered 640x480 images of a ball that goes in and out, so that drawing costs
nothing. The null daemon reads the same ring and offers the same ``height``, ``cloud`` and ``contact`` bytes under
each frame's time stamp, without reconstructing: what it takes is transport. Latency is from the frame's time stamp to
the end of the subscriber's decode; both read the same CLOCK_MONOTONIC. The ring (29 MB) is in the peak memory of both.

With ``--record`` it is the daemon alone and the daemon asked to record, to the folder for temporary files. The ring is
then grey, as a camera's frames are (10 MB), and what encoding a frame costs is told for both kinds.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from tacshade_edge.cli.demo_sensor import make_calibration
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.daemon.app import App
from tacshade_edge.daemon.ledger import FrameLedger
from tacshade_edge.devices import calibration_file, registry
from tacshade_edge.devices.mqtt_caller import MqttCaller
from tacshade_edge.devices.network import make_reconstructor
from tacshade_edge.devices.recorder import PNG_OPTIONS
from tacshade_edge.devices.simulated import SimulatedSource
from tacshade_edge.protocol import messages, wire
from tacshade_edge.settings import Document, load
from tacshade_edge.simulator.objects import ball
from tacshade_edge.simulator.press import Press
from tacshade_edge.simulator.script import Script
from tacshade_edge.types import Frame, Reconstruction

RING = 32
BASE = "tacshade/bench"
OUTCOMES = ("published", "superseded", "without_contact", "invalid", "failed")


class GreyRing(SimulatedSource):
    """The ring as a camera would give it."""

    def read(self) -> Frame:
        """The next frame, of one channel."""
        frame = super().read()
        return dataclasses.replace(frame, image=np.ascontiguousarray(frame.image[:, :, 1]))


def ring_source(fps: float, kind: type[SimulatedSource] = SimulatedSource) -> SimulatedSource:
    """The ring, rendered already; a few of its frames are without contact."""
    script = Script((Press(ball(6.0), 1.0, -2.0, 3.5),), approach=RING // 2 - 1, hold=8, release=8, pause=1)
    source = kind(fps=fps, script=script, ring=RING)
    source.open()
    source.close()
    return source


def cost(began: resource.struct_rusage, began_s: float) -> dict[str, float]:
    """CPU since `began` as a ratio of one core, and this process's peak memory."""
    now = resource.getrusage(resource.RUSAGE_SELF)
    cpu_s = now.ru_utime + now.ru_stime - began.ru_utime - began.ru_stime
    return {"cpu_ratio": round(cpu_s / (time.monotonic() - began_s), 3), "peak_mb": round(now.ru_maxrss / 1024, 1)}


def daemon(document: Document, fps: float, kind: type[SimulatedSource] = SimulatedSource) -> None:
    """The real one, on the ring."""
    source = ring_source(fps, kind)
    app = App(document, source, registry.load_calibration(document))
    signal.signal(signal.SIGTERM, lambda *_: app.stop())
    began, began_s = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
    app.run()
    print(json.dumps(cost(began, began_s)))


def null_daemon(document: Document, fps: float) -> None:
    """The same bytes at the same rate."""
    source = ring_source(fps)
    calibration = registry.load_calibration(document)
    reconstructor = make_reconstructor(calibration, PROFILES[document.settings.profile])
    source.open()
    ready: dict[int, Reconstruction] = {}
    while len(ready) < RING:
        frame = source.read()
        ready[frame.seq % RING] = reconstructor.step(frame)
    source.close()

    ledger = FrameLedger()
    link = registry.make_link(
        document,
        on_request=lambda request: None,
        on_outcome=lambda stream, seq, outcome: ledger.settle(seq, outcome) if stream == "height" else None,
    )
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    link.start()
    source.open()
    began, began_s = resource.getrusage(resource.RUSAGE_SELF), time.monotonic()
    while not stop.is_set():
        frame = source.read()
        ledger.captured(frame.seq)
        result = dataclasses.replace(ready[frame.seq % RING], seq=frame.seq, t_ns=frame.t_ns, wall_ns=frame.wall_ns)
        if not result.contact:
            ledger.settle(frame.seq, "without_contact")
            continue
        link.offer("height", wire.encode_height(result, calibration_crc32=calibration.crc32), frame.seq)
        link.offer("cloud", wire.encode_cloud(result, calibration_crc32=calibration.crc32), frame.seq)
        link.offer("contact", messages.encode_contact(result, fps=fps), frame.seq)
    ledger.close(1.0)
    link.set_retained("health", messages.encode_health({"frames": ledger.counts().as_dict()}), qos=0)
    link.stop(1.0)
    print(json.dumps(cost(began, began_s)))


def subscriber(port: int, warm_up: int) -> None:
    """Decode every height map; print latencies in ms and the last ``health`` once the daemon has stopped."""
    latencies: list[float] = []
    seqs: set[int] = set()
    health: dict[str, Any] = {}
    done = threading.Event()

    def on_message(_client: Client, _data: None, message: MQTTMessage) -> None:
        if message.retain:  # of the run before
            return
        if message.topic == f"{BASE}/height":
            decoded = wire.decode(message.payload)
            latencies.append((time.monotonic_ns() - decoded.t_ns) / 1e6)
            seqs.add(decoded.seq)
        elif message.topic == f"{BASE}/health":
            health.update(json.loads(message.payload))
        elif message.topic == f"{BASE}/state" and message.payload == b"stopped":
            done.set()

    client = Client(CallbackAPIVersion.VERSION2)
    client.on_message = on_message
    client.on_subscribe = lambda *_: print("ready", flush=True)
    client.connect("127.0.0.1", port)
    client.subscribe(f"{BASE}/#", qos=1)
    client.loop_start()
    done.wait()
    client.disconnect()
    client.loop_stop()
    steady = sorted(latencies[warm_up:])
    figures = {name: round(steady[int(len(steady) * part)], 2) for name, part in (("p50", 0.5), ("p99", 0.99))}
    figures["max"] = round(steady[-1], 2)
    print(json.dumps({"received": len(latencies), "distinct": len(seqs), "latency_ms": figures, "health": health}))


@contextlib.contextmanager
def broker(folder: Path) -> Iterator[int]:
    """A mosquitto on a free loopback port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = int(probe.getsockname()[1])
    config = folder / "mosquitto.conf"
    user = "user root\n" if os.getuid() == 0 else ""
    config.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\npersistence false\n{user}")
    command = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if command is None:
        raise SystemExit("bench_daemon: found no mosquitto, expected Debian's package mosquitto")
    process = subprocess.Popen([command, "-c", config], stderr=subprocess.DEVNULL)
    try:
        while True:
            with socket.socket() as probe:
                if probe.connect_ex(("127.0.0.1", port)) == 0:
                    break
            if process.poll() is not None:
                raise SystemExit("bench_daemon: mosquitto ended at once")
            threading.Event().wait(0.02)
        yield port
    finally:
        process.terminate()
        process.wait()


def measure(role: str, config: Path, port: int, args: argparse.Namespace) -> dict[str, Any]:
    """One run of one kind of daemon."""
    me = [sys.executable, __file__]
    listen = subprocess.Popen(
        [*me, "--role", "subscriber", "--port", str(port), "--fps", str(args.fps)], stdout=subprocess.PIPE, text=True
    )
    assert listen.stdout is not None
    assert listen.stdout.readline() == "ready\n"
    worker = subprocess.Popen(
        [*me, "--role", role, "--config", str(config), "--fps", str(args.fps), *["--record"] * args.record],
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        if role == "recording":
            record(load(config), args.seconds)
        else:
            threading.Event().wait(args.seconds)
        worker.send_signal(signal.SIGTERM)
        costs = json.loads(worker.communicate(timeout=20)[0])
        figures: dict[str, Any] = json.loads(listen.communicate(timeout=20)[0])
    finally:
        worker.kill()
        listen.kill()
    frames = figures["health"]["frames"]
    accounted = frames["pending"] == 0 and frames["captured"] == sum(frames[name] for name in OUTCOMES)
    accounted = accounted and figures["received"] == figures["distinct"] == frames["published"]
    return {"role": role, **costs, **figures, "accounted": accounted}


def record(document: Document, seconds: float) -> None:
    """Ask the daemon for a recording as soon as it runs, and wait until it should be over."""
    began_s, pause = time.monotonic(), threading.Event()
    caller = MqttCaller(
        registry.broker_address(document), sensor_id=document.settings.sensor_id, verb="record", watched=("state",)
    )
    caller.start()
    if not caller.wait_for(lambda: caller.latest("state") == b"online", 20):
        raise SystemExit("bench_daemon: the daemon does not come online")
    caller.ask({"action": "start", "seconds": seconds - (time.monotonic() - began_s) - 1.0}, 5)
    caller.stop()
    pause.wait(began_s + seconds - time.monotonic())


def encoding() -> str:
    """What the recorder's encoding of a frame costs, beside OpenCV's with zlib's level 1 alone."""
    source = ring_source(60)
    source.open()
    colour = [source.read().image for _ in range(RING)]
    lines = []
    for what, images in (("grey", [np.ascontiguousarray(image[:, :, 1]) for image in colour]), ("colour", colour)):
        for name, options in (("recorder", PNG_OPTIONS), ("zlib level 1", (cv2.IMWRITE_PNG_COMPRESSION, 1))):
            ms, sizes = [], []
            for image in images:
                began_s = time.thread_time()
                _, png = cv2.imencode(".png", image, options)
                ms.append(1e3 * (time.thread_time() - began_s))
                sizes.append(png.size)
            lines.append(f"{what}, {name}: {np.median(ms):.1f} ms, {np.median(sizes) / 1e3:.0f} kB")
    return "\n".join(lines)


def table(results: list[dict[str, Any]]) -> str:
    """For a person."""
    head = ["", "p50 ms", "p99 ms", "max ms", "CPU core", "peak MB", "captured", *OUTCOMES, "received", "accounted"]
    rows = [head]
    for r in results:
        ms, frames = r["latency_ms"], r["health"]["frames"]
        row = [r["role"], ms["p50"], ms["p99"], ms["max"], r["cpu_ratio"], r["peak_mb"], frames["captured"]]
        rows.append([str(v) for v in [*row, *(frames[o] for o in OUTCOMES), r["received"], r["accounted"]]])
    widths = [max(len(row[i]) for row in rows) for i in range(len(head))]
    return "\n".join("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)) for row in rows)


def main() -> int:
    """Run both daemons one after the other; exit 1 when a frame is not accounted for."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--fps", type=float, default=60.0)
    parser.add_argument("--seconds", type=float, default=20.0, help="of each run, start included")
    parser.add_argument("--profile", choices=list(PROFILES), default="fast")
    parser.add_argument("--record", action="store_true", help="the daemon without and with a recording")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the figures there too")
    for hidden, kind in (("--role", str), ("--config", Path), ("--port", int)):  # of the child processes
        parser.add_argument(hidden, type=kind, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.role == "subscriber":
        subscriber(args.port, warm_up=round(2 * args.fps))
        return 0
    if args.role:
        document = load(args.config)
        if args.role == "null":
            null_daemon(document, args.fps)
        else:
            daemon(document, args.fps, GreyRing if args.record else SimulatedSource)
        return 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        calibration_file.save(folder / "c.npz", make_calibration())
        with broker(folder) as port:
            config = folder / "config.yaml"
            config.write_text(
                f"sensor_id: bench\nprofile: {args.profile}\ncalibration: c.npz\n"
                f"source: {{kind: simulated}}\nmqtt: {{host: 127.0.0.1, port: {port}}}\nrecorder: {{folder: recs}}\n"
            )
            roles = ("daemon", "recording") if args.record else ("daemon", "null")
            results = [measure(role, config, port, args) for role in roles]
    print(table(results))
    stages = results[0]["health"]["stages_ms"]
    print("stages, p50 / p99 ms: " + ", ".join(f"{name} {s['p50']} / {s['p99']}" for name, s in stages.items()))
    if args.record:
        print(f"recorder: {results[1]['health']['recorder']}\n{encoding()}")
    if args.json:
        args.json.write_text(json.dumps(results, indent=1) + "\n")
    return 0 if all(r["accounted"] for r in results) else 1


if __name__ == "__main__":
    sys.exit(main())
