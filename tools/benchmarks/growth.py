"""How cost grows: processor time, peak memory and bytes at several sizes, with their exponents.

::

    .venv/bin/python -m tools.benchmarks.growth [--only NAME ...]

Each size runs in a process of its own. Time is of the processor, in all threads; memory is the
greatest that the work adds to its process; bytes are those that it writes or sends. An exponent is
the slope of the logarithms over the three largest sizes: 1 is linear; too small a cost has none.
Fingers and subscribers are of a running daemon with `FPS` frames a second of each finger, in
contact: time and bytes are per second.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from support.mqtt_rig import Broker, Subscriber
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.free_memory import return_free_memory
from tacshade_edge.lab.demo.demo_hand import make_calibration
from tacshade_edge.lab.studies.markdown import markdown
from tacshade_edge.recording.frame_table import HEADER, MORE, TABLE_NAME, line_crc32
from tacshade_edge.recording.recorder import RecordingWriter, png_of
from tacshade_edge.recording.recording import Recording
from tacshade_edge.rigid import shift
from tacshade_edge.sensor.touch.learning import learn
from tacshade_edge.stitching.map_files import write_map
from tacshade_edge.stitching.press_points import PressPoints
from tacshade_edge.stitching.session import MapPublisher, MapRevision, StitchSession
from tacshade_edge.stitching.stitcher import STEP_MM, Raster
from tacshade_edge.types import F32, Frame, Pose
from tools.testbed.daemon_rig import cpu_s, draw_rings, family, pss_mb

FPS, MEASURED_S = 5.0, 8.0
TOPICS = ("height", "contact")
LEAST_S, LEAST_MB, LEAST_BYTES = 0.02, 2.0, 100
"""Costs below have no exponent: they are the ticks and pages of the process."""
FITTED = 3
"""Sizes that an exponent is fitted to, the largest: a fixed cost hides the growth of small ones."""
SIDE_BY_SIDE = 4
PITCH_MM, RADIUS_MM, SPACING_MM = 4.0, 3.0, 0.3
"""Of presses: their distance, and the radius and the distance of the points of each."""
FEATURES, HIDDEN, ROWS_A_PRESS = 1024, 6, 10


@dataclass(frozen=True, slots=True)
class Cost:
    """What a size took."""

    time_s: float
    peak_mb: float
    bytes: int


class Meter:
    """Processor time since `begin`, and peak memory over that of its making."""

    def __init__(self) -> None:
        # What an earlier part has freed must not hide what this one takes, nor the imports' peak.
        return_free_memory()
        Path("/proc/self/clear_refs").write_text("5")
        self._before_mb = _status_mb("VmRSS")
        self.begin()

    def begin(self) -> None:
        """Count time from here on."""
        self._began_s = time.process_time()

    def cost(self, written: int) -> Cost:
        """The cost until now."""
        taken_s = time.process_time() - self._began_s
        return Cost(taken_s, max(0.0, _status_mb("VmHWM") - self._before_mb), written)


def _status_mb(field: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{field}:")) / 1024


def bytes_in(folder: Path) -> int:
    """Bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def packet(kind: int, body: bytes) -> bytes:
    """An MQTT 3.1.1 packet of less than 128 bytes."""
    return bytes((kind, len(body))) + body


class Drain:
    """Subscribers that read and count all that comes, in one thread: clients of a library would
    take more of the machine than what is measured.
    """

    def __init__(self, port: int, count: int) -> None:
        self.bytes = 0
        self._stopped = threading.Event()
        self._selector = selectors.DefaultSelector()
        for k in range(count):
            name, topic = f"drain{k}".encode(), b"tacshade/#"
            one = socket.create_connection(("127.0.0.1", port))
            one.sendall(packet(0x10, b"\0\4MQTT\4\2\0\0" + len(name).to_bytes(2, "big") + name))
            one.sendall(packet(0x82, b"\0\1" + len(topic).to_bytes(2, "big") + topic + b"\0"))
            self._selector.register(one, selectors.EVENT_READ)
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Drain:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join()
        for key in list(self._selector.get_map().values()):
            key.fileobj.close()  # type: ignore[union-attr]

    def _run(self) -> None:
        buffer = bytearray(1 << 20)
        while not self._stopped.is_set():
            for key, _ in self._selector.select(0.1):
                assert isinstance(key.fileobj, socket.socket)
                self.bytes += key.fileobj.recv_into(buffer)


@contextlib.contextmanager
def daemon(folder: Path, port: int, fingers: int) -> Iterator[list[int]]:
    """A running hand; the ids of its processes, once every finger is online."""
    draw_rings(folder)
    calibration, parts = make_calibration(), []
    for k in range(fingers):
        calibration_file.save(folder / f"finger{k}.npz", calibration)
        place = f"hand_T_sensor: [{30 * k}, 0, 90, 1, 0, 0, 0]"
        own = f"calibration: finger{k}.npz, source: {{kind: simulated}}, {place}"
        parts.append(f"  finger{k}: {{{own}}}\n")
    text = f"hand_id: bench\nmqtt: {{host: 127.0.0.1, port: {port}}}\n"
    (folder / "hand.yaml").write_text(
        f"{text}recorder: {{folder: recs}}\nstitching: {{folder: maps}}\nsensors:\n{''.join(parts)}"
    )
    words = [str(folder / "hand.yaml"), str(FPS), *[str(folder / "contact.npy")] * fingers]
    with Subscriber(port, "tacshade/+/state") as seen:
        command = [sys.executable, "-m", "tacshade_edge.lab.trial.ring_daemon", *words]
        running = subprocess.Popen(command)
        try:
            for k in range(fingers):
                seen.wait_for(f"tacshade/finger{k}/state", timeout_s=60)
            assert running.poll() is None, "the daemon ended"
            yield family(running.pid)
            running.send_signal(signal.SIGTERM)
            running.wait(60)
        finally:
            running.kill()


def served(folder: Path, fingers: int, subscribers: int) -> tuple[Cost, Cost]:
    """What the daemon and the broker take for a second, once all have run for two."""
    pause = threading.Event()
    with (
        Broker(folder) as broker,
        daemon(folder, broker.port, fingers) as pids,
        Drain(broker.port, subscribers) as drain,
    ):
        pause.wait(2)
        before, came, began_s = _used(pids, broker.pid), drain.bytes, time.monotonic()
        pause.wait(MEASURED_S)
        after, took_s = _used(pids, broker.pid), time.monotonic() - began_s
        sent = round((drain.bytes - came) / took_s)
        memory = sum(map(pss_mb, pids)), pss_mb(broker.pid)
    daemon_s, broker_s = ((b - a) / took_s for a, b in zip(before, after, strict=True))
    return Cost(daemon_s, memory[0], sent // subscribers), Cost(broker_s, memory[1], sent)


def _used(pids: Sequence[int], broker: int) -> tuple[float, float]:
    return sum(map(cpu_s, pids)), cpu_s(broker)


def fingers(size: int, folder: Path) -> dict[str, Cost]:
    """A hand of so many fingers, and one subscriber."""
    return {"fingers: the daemon": served(folder, size, 1)[0]}


def subscribers(size: int, folder: Path) -> dict[str, Cost]:
    """So many subscribers to a finger."""
    one, broker = served(folder, 1, size)
    return {"subscribers: the daemon": one, "subscribers: the broker": broker}


def cap(random: np.random.Generator) -> PressPoints:
    """The points of a press on a rough plane."""
    x, y = np.mgrid[-RADIUS_MM:RADIUS_MM:SPACING_MM, -RADIUS_MM:RADIUS_MM:SPACING_MM]
    inside = np.hypot(x, y) < RADIUS_MM
    z = 20 + 0.02 * random.normal(size=x.shape)
    points = np.stack((x, y, z), axis=-1)[inside].astype(np.float32)
    normals = np.tile(np.array((0, 0, 1), np.float32), (len(points), 1))
    return PressPoints(points, normals, np.ones(len(points), np.float32))


def session(size: int, folder: Path) -> dict[str, Cost]:
    """A session of so many presses, over an area that grows with them: each is added, the map made,
    and the session resumed as after a crash.
    """
    calibration, random = make_calibration(), np.random.default_rng(0)
    side, found = math.ceil(math.sqrt(size)), {}
    meter = Meter()
    made = StitchSession.begin(folder, "session", calibration, "bench")
    for k in range(size):
        row, col = divmod(k, side)
        made.add(cap(random), shift(PITCH_MM * col, PITCH_MM * row, 0.0), k)
    found["presses: added"] = meter.cost(bytes_in(folder))
    made.file.close()
    meter = Meter()
    resumed = StitchSession.resume(folder, "bench")
    assert resumed is not None
    assert resumed.presses == size
    found["presses: resumed"] = meter.cost(bytes_in(folder))
    before = bytes_in(folder)
    meter.begin()
    resumed.finish(0)
    return found | {"presses: map made": meter.cost(bytes_in(folder) - before)}


def map_of_area(size: float, folder: Path) -> dict[str, Cost]:
    """A full map of so many square metres: its files, and its messages."""
    side = round(1000 * math.sqrt(size) / STEP_MM)
    z_mm = np.random.default_rng(0).normal(size=(side, side)).astype(np.float32)
    raster, found, sent = Raster(z_mm, 0.0, 0.0, STEP_MM), {}, list[int]()
    meter = Meter()
    MapPublisher(lambda _topic, payload: sent.append(len(payload))).publish(
        MapRevision("bench", 1, 1, 1, 0, "", lambda: raster)
    )
    found["square metres: a revision sent"] = meter.cost(sum(sent))
    meter = Meter()
    write_map(folder / "map", raster, {})
    return found | {"square metres: files written": meter.cost(bytes_in(folder / "map"))}


def recording(size: int, folder: Path) -> dict[str, Cost]:
    """A recording of so many frames: written, with the sync of each second, and read."""
    draw_rings(folder)
    images = np.load(folder / "contact.npy")
    pngs, pose = [png_of(image) for image in images], Pose(0, 1.25, 2.5, 3.75, 1.0, 0.0, 0.0, 0.0)
    meter = Meter()
    writer = RecordingWriter(folder / "recording")
    writer.begin("", b"")
    for k in range(size):
        writer.add(Frame(k, k * 33_333_333, 0, images[k % len(images)], pose), pngs[k % len(pngs)])
        writer.event(k * 33_333_333, "bench", {"frame": k})
        if k % 30 == 0:
            writer.sync()
    writer.finish({})
    found = {"frames: recorded": meter.cost(bytes_in(folder / "recording"))}
    meter = Meter()
    opened = Recording(folder / "recording")
    while opened.read() is not None:
        pass
    return found | {"frames: read": meter.cost(bytes_in(folder / "recording"))}


def table(size: int, folder: Path) -> dict[str, Cost]:
    """The table of a recording of so many frames: opened, and all its frames found but not read."""
    with (folder / TABLE_NAME).open("w") as file:
        file.write(",".join((*HEADER, *MORE)) + "\n")
        for k in range(size):
            columns = f"{k:06d}.png,{k * 33_333_333},1.25,2.5,3.75,1.0,0.0,0.0,0.0,500"
            file.write(f"{columns},{line_crc32(columns)}\n")
    meter = Meter()
    opened = Recording(folder)
    while opened.next_entry() is not None:
        pass
    return {"frames: table of a recording read": meter.cost(bytes_in(folder))}


def labels(size: int, folder: Path) -> dict[str, Cost]:
    """A touch model learnt from so many labelled frames, in presses of ten."""
    return {"labels: learnt": _learnt(size, folder, np.arange(size) // ROWS_A_PRESS)}


def few_presses(size: int, folder: Path) -> dict[str, Cost]:
    """As many labels in ten long presses."""
    groups = np.arange(size) * ROWS_A_PRESS // size
    return {"labels: learnt, of ten presses": _learnt(size, folder, groups)}


def _learnt(size: int, folder: Path, groups: np.typing.NDArray[np.int64]) -> Cost:
    random = np.random.default_rng(0)
    hidden = random.uniform(-1, 1, (size, HIDDEN))
    meter = Meter()
    features: F32 = np.maximum(hidden @ random.normal(size=(HIDDEN, FEATURES)), -0.5).astype(
        np.float32
    )
    imprints = random.normal(size=(size, 7)).astype(np.float32)
    known = hidden[:, :1] + 0.05 * random.normal(size=(size, 1))
    meter.begin()
    found = learn(features, imprints, np.ones(size), ("depth_mm",), known, groups, "bench")
    assert found.model is not None
    cost = meter.cost(0)
    calibration_file.save(folder / "c.npz", make_calibration())
    bare = bytes_in(folder)
    calibration_file.save(
        folder / "c.npz", replace(make_calibration(), touch={"balanced": found.model})
    )
    return replace(cost, bytes=bytes_in(folder) - bare)


Case = Callable[[int, Path], dict[str, Cost]]
CASES: dict[str, tuple[Case, tuple[float, ...]]] = {
    "labels": (labels, (60, 100, 300, 1000)),
    "session": (session, (10, 100, 300, 1000, 3000)),
    "recording": (recording, (30, 100, 300, 600)),
    "table": (table, (1000, 10_000, 30_000, 100_000)),
    "map": (map_of_area, (0.01, 0.1, 0.3, 1.0)),
    "few_presses": (few_presses, (60, 100, 300, 600)),
    "fingers": (fingers, (1, 2, 5, 10)),
    "subscribers": (subscribers, (1, 10, 30, 100)),
}


def exponent(sizes: Sequence[float], costs: Sequence[float], least: float) -> str:
    """The slope of the logarithms at the largest sizes; empty if the costs are too small."""
    if costs[-1] < least or min(costs[-FITTED:]) <= 0:
        return ""
    slope = np.polyfit(np.log(sizes[-FITTED:]), np.log(costs[-FITTED:]), 1)[0]
    return f"{slope:.2f}"


def rows(sizes: Sequence[float], found: Sequence[Mapping[str, Cost]]) -> list[list[str]]:
    """Rows of the table from the costs at each size."""
    made = []
    for name in found[0]:
        costs = [one[name] for one in found]
        cells = [name, " / ".join(f"{size:,}" for size in sizes)]
        for field, least, factor in (
            ("time_s", LEAST_S, 1.0),
            ("peak_mb", LEAST_MB, 1.0),
            ("bytes", LEAST_BYTES, 1e-6),
        ):
            values = [factor * getattr(cost, field) for cost in costs]
            cells.append(" / ".join(f"{value:.3g}" for value in values))
            cells.append(exponent(sizes, values, least * factor))
        made.append(cells)
    return made


def at_size(name: str, size: float) -> dict[str, Cost]:
    """One case at one size, in a process of its own."""
    words = [sys.executable, "-m", "tools.benchmarks.growth", "--case", name, "--size", f"{size:g}"]
    # One thread: how many a library starts is the machine's, not the work's.
    alone = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    done = subprocess.run(words, env=alone, stdout=subprocess.PIPE, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    return {key: Cost(**cost) for key, cost in found.items()}


def main() -> None:
    """Measure all cases and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", choices=list(CASES), nargs="+", default=list(CASES))
    for hidden, kind in (("--case", str), ("--size", float)):  # for the process of a size
        parser.add_argument(hidden, type=kind, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case is not None:
        measure, sizes = CASES[args.case]
        size = args.size if isinstance(sizes[0], float) else int(args.size)
        with tempfile.TemporaryDirectory() as name:
            costs = measure(size, Path(name))
        print(json.dumps({key: asdict(cost) for key, cost in costs.items()}))
        return
    # The largest first: they take longest, and nothing should wait for them at the end.
    jobs = [(name, size) for name in args.only for size in reversed(CASES[name][1])]
    with ThreadPoolExecutor(SIDE_BY_SIDE) as pool:
        found = dict(zip(jobs, pool.map(lambda job: at_size(*job), jobs), strict=True))
    lines = []
    for name in args.only:
        sizes = CASES[name][1]
        lines += rows(sizes, [found[name, size] for size in sizes])
    head = ["what", "sizes", "processor s", "exponent", "memory MB", "exponent", "MB", "exponent"]
    print(markdown(head, lines))


if __name__ == "__main__":
    main()
