"""Measure the bridge to ROS 2: time per message and memory, with a router and a subscriber in
another process.

::

    .venv/bin/python -m tools.benchmarks.ros2 [--frames 600]

The times are those that the bridge keeps paho's thread for one message: decoding, encoding and
handing it to Zenoh; the processor's time of that thread, and the time on the clock, which a machine
with other work prolongs. Decoding alone is there to compare. Memory is read from /proc before
Zenoh is imported and after all messages; what other libraries need is in both. Files are pages of
libraries, which the kernel can drop and read again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from typing import Any

import numpy as np

# Of every bridge, so that its memory is in both figures.
import tacshade_edge.bridge.roster
import tacshade_edge.mqtt.follower
import tacshade_edge.wire.topics  # noqa: F401
from support.mqtt_rig import free_port
from support.patience import wait_until
from tacshade_edge.wire import wire_format
from tacshade_edge.wire.wire_format import CLOUD, HEIGHT, SCALE_MM, Header, pack
from tools.testbed.daemon_rig import memory_mb

LIMIT_MS, LIMIT_MB = 0.3, 10.0
SENSOR = "left-index"
POINTS = 2000
GRIDS = {"height 112x112": 112, "height 56x56": 56}
INFO = b'{"profile": "fast", "geometry": null}'


def header(seq: int) -> Header:
    """The fields of a frame in contact."""
    return Header(
        seq=seq,
        calibration_crc32=1,
        t_ns=seq,
        wall_ns=time.time_ns(),
        contact=True,
        invalid=False,
        saturated=False,
        degraded=False,
        touched=False,
        pose=None,
        pose_error_us=0,
    )


def height(seq: int, side: int) -> bytes:
    """A map of random heights."""
    steps = np.random.default_rng(seq).integers(-100, 2000, side * side, np.int16)
    return pack(HEIGHT, (side, side), (0.0, 0.0, 4.0, SCALE_MM), steps.tobytes(), header(seq))


def cloud(seq: int, points: int) -> bytes:
    """A cloud of random points of one object."""
    places = np.random.default_rng(seq).normal(0, 10, (points, 3)).astype(np.float32)
    data = places.tobytes() + np.ones(points, np.uint16).tobytes()
    return pack(CLOUD, (points, 0), (0.0, 0.0, 0.0, SCALE_MM), data, header(seq))


def listen(port: int, over: Event) -> None:
    """Be the router, and subscribe to the height and the cloud, in a process of its own."""
    import zenoh

    from tacshade_edge.bridge import ros_messages
    from tacshade_edge.bridge.ros_graph import RosTopic

    config = {
        "mode": "router",
        "listen": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
        "scouting": {"multicast": {"enabled": False}},
        "timestamping": {"enabled": True},
    }
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
    held: list[Any] = []
    for name, kind in (("height", ros_messages.IMAGE), ("cloud", ros_messages.CLOUD)):
        topic = RosTopic(f"/tacshade/left_index/{name}", kind, 5)
        *_, dds_name, rihs01 = topic.key(0).split("/")
        token = f"@ros2_lv/0/b/0/1/MS/%/%/rviz/{topic.name.replace('/', '%')}/{dds_name}/{rihs01}"
        held.append(session.declare_subscriber(topic.key(0), lambda _: None))
        held.append(session.liveliness().declare_token(f"{token}/{topic.qos()}"))
    over.wait()
    session.close()


@dataclass(frozen=True, slots=True)
class Taken:
    """For one message, in ms: the calling thread's processor time, and the time on the clock."""

    cpu_ms: float
    p50_ms: float
    p99_ms: float


def timed(handle: Callable[[bytes], object], payloads: list[bytes]) -> Taken:
    """Time each payload."""
    cpu_s, wall_s = [], []
    for payload in payloads:
        began_s, began_cpu_s = time.perf_counter(), time.thread_time()
        handle(payload)
        cpu_s.append(time.thread_time() - began_cpu_s)
        wall_s.append(time.perf_counter() - began_s)
        # Frames do not come at once: what Zenoh's threads do is in between.
        time.sleep(0.002)
    p50_s, p99_s = np.percentile(wall_s, (50, 99))
    return Taken(1000 * float(np.median(cpu_s)), 1000 * float(p50_s), 1000 * float(p99_s))


def drawn(frames: int) -> dict[str, tuple[str, list[bytes]]]:
    """The payloads of each kind of message, with the topic that they come by."""
    every = {
        name: ("height", [height(seq, side) for seq in range(frames)])
        for name, side in GRIDS.items()
    }
    return every | {f"cloud of {POINTS}": ("cloud", [cloud(seq, POINTS) for seq in range(frames)])}


Times = dict[str, tuple[Taken, Taken]]
"""Of each kind of message: the bridge's, and those of decoding alone."""


def measure(
    port: int, payloads: dict[str, tuple[str, list[bytes]]]
) -> tuple[Times, dict[str, float], dict[str, float]]:
    """The times, and the memory before and after."""
    before = memory_mb(os.getpid())
    from tacshade_edge.bridge.ros2 import Ros2Bridge

    asked: set[str] = set()
    bridge = Ros2Bridge(f"tcp/127.0.0.1:{port}", 0, [SENSOR], asked.update)
    base = f"tacshade/{SENSOR}"

    def polled(name: str) -> bool:
        bridge.poll()
        return f"{base}/{name}" in asked

    wait_until(lambda: polled("info"), 20, "connected")
    bridge.hear(f"{base}/info", INFO, is_retained=True)
    wait_until(lambda: polled("height") and polled("cloud"), 20, "a subscriber")
    found: Times = {}
    for name, (topic, every) in payloads.items():

        def hear(payload: bytes, topic: str = topic) -> None:
            bridge.hear(f"{base}/{topic}", payload, is_retained=False)

        found[name] = timed(hear, every), timed(wire_format.decode, every)
    after = memory_mb(os.getpid())
    bridge.stop()
    return found, before, after


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=600)
    payloads = drawn(parser.parse_args().frames)
    spawned = multiprocessing.get_context("spawn")
    port, over = free_port(), spawned.Event()
    other = spawned.Process(target=listen, args=(port, over))
    other.start()
    try:
        found, before, after = measure(port, payloads)
    finally:
        over.set()
        other.join()
    print("| message | processor, ms | of the limit | times decoding alone | p50 / p99, ms |")
    print("|---|---|---|---|---|")
    for name, (all_of_it, decoding) in found.items():
        ratios = f"{all_of_it.cpu_ms / LIMIT_MS:.2f} | {all_of_it.cpu_ms / decoding.cpu_ms:.1f}"
        wall = f"{all_of_it.p50_ms:.3f} / {all_of_it.p99_ms:.3f}"
        print(f"| {name} | {all_of_it.cpu_ms:.3f} | {ratios} | {wall} |")
    more = {name: after[name] - before[name] for name in before}
    print(
        f"memory: own {more['own']:.1f} MB more ({more['own'] / LIMIT_MB:.2f} of the limit), "
        f"libraries' files {more['files']:.1f} MB more"
    )


if __name__ == "__main__":
    main()
