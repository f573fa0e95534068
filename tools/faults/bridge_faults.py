"""Attacks by a client of the broker or of a bridge's port, and their effect on all other clients.

During each attack, a real sensor publishes and must remain visible.
"""

from __future__ import annotations

import contextlib
import json
import re
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tacshade_edge.protocol import messages, wire
from tools.faults.rig import Cell, Seen, pause
from tools.testbed.bridge_process import BridgeProcess
from tools.testbed.patience import stretched
from tools.testbed.published_health import health
from tools.testbed.published_sensor import CRC, PublishedSensor, bump

FOXGLOVE = Subprotocol("foxglove.sdk.v1")
MEMORY_MB_MAX = 400.0
STOP_S_MAX = 2.0
THREADS_MAX = 40
IDLE = 400
NAMES = 1000
VIEWERS = 10
REAL = "right"
HUGE = "1" + "0" * 400


def hostile_infos() -> Iterator[bytes]:
    """Yield `info` messages with geometries that no sensor has."""
    from tools.testbed.published_sensor import calibration

    info = json.loads(messages.encode_info(version="0", config_digest="0", profile="fast", calibration=calibration()))
    for key in ("radius_px", "skin_radius_mm", "visible_half_angle_deg", "row_c", "camera_distance_mm"):
        for value in ("0", "-1", "1e-300", "1e308", "1e999", HUGE, "null", '"x"', "[]"):
            changed = {**info, "geometry": {**info["geometry"], key: "?"}}
            yield json.dumps(changed).replace('"?"', value).encode()
    flange = {**info, "geometry": {**info["geometry"], "flange_T_sensor": [0.0] * 7}}
    yield json.dumps(flange).encode()
    yield from (b"{", b"[]", b"\xff", b"[" * 60_000, b"{}", b"0")


def hostile_healths() -> Iterator[bytes]:
    """Yield `health` messages with numbers, names and amounts that no daemon reports."""
    told = json.loads(health())
    for key in ("uptime_s", "capture_fps", "source_dropped"):
        for value in (HUGE, "1e308", "1e999", "-1", "null", '"x"', "[]"):
            yield json.dumps({**told, key: "?"}).replace('"?"', value).encode()
    for value in (HUGE, "-1", '"x"'):
        yield json.dumps({**told, "frames": {"published": "?"}}).replace('"?"', value).encode()
    yield json.dumps({**told, "frames": {'a"} 1\nforged{x="': 1}}).encode()
    yield from (b"{", b"[]", b"\xff", b"[" * 60_000, b"{}")


def million_keys() -> bytes:
    """Make a `health` message of 17 MB."""
    told = json.loads(health())
    return json.dumps({**told, "frames": {f"k{number}": number for number in range(1_000_000)}}).encode()


@contextmanager
def idle(port: int, count: int) -> Iterator[int]:
    """Hold silent connections open; yield how many were not refused immediately."""
    with contextlib.ExitStack() as opened:
        held = 0
        for _ in range(count):
            with contextlib.suppress(OSError):
                opened.enter_context(socket.create_connection(("127.0.0.1", port), 5))
                held += 1
        yield held


# -- Prometheus -----------------------------------------------------------------------------------------------------


def scraped(bridge: BridgeProcess, sensor: PublishedSensor) -> bool:
    """Whether the page reports the real sensor as alive."""
    sensor.publish("health", health())
    with contextlib.suppress(OSError):
        return f'tacshade_up{{sensor="{REAL}"}} 1.0' in bridge.page()
    return False


@dataclass(frozen=True, slots=True)
class Told:
    """Where a person finds the report; `logged` is the text that the bridge's log then contains."""

    where: str
    logged: str = ""


REFUSED = Told("log", r"bad: \w+: ")
NO_ROOM = Told("log", r": ignoring this sensor: \d+ are already")
COUNTED = Told("log, `tacshade_bridge_refused_total`", r"bad: health: ")
COUNTED_NO_ROOM = Told("log, `tacshade_bridge_refused_total`", NO_ROOM.logged)
SLOW = Told("log: how many each viewer was too slow for", r"a viewer that read too slowly missed \d+ messages")
TURNED_AWAY = Told("nowhere: a connection too many is closed")


def metrics(
    cell: Cell, attack: Callable[[PublishedSensor, BridgeProcess], None], told: Told, *, first: bool = False
) -> Seen:
    """Attack readers of metrics; with `first`, before the real sensor and the bridge start."""
    cell.serve()
    with contextlib.ExitStack() as opened:
        bad = opened.enter_context(PublishedSensor(cell.broker.port, "bad"))
        bridge = BridgeProcess("prometheus", cell.broker.port, cell.folder / "bridge.log")
        if first:
            attack(bad, bridge)
        real = opened.enter_context(PublishedSensor(cell.broker.port, REAL))
        opened.enter_context(bridge)
        cell.until(lambda: scraped(bridge, real), 20, f"the real sensor, in {bridge.log()[-300:]!r}")
        if not first:
            attack(bad, bridge)
        since_s = time.monotonic()
        cell.until(lambda: scraped(bridge, real), 20, f"the real sensor after it, in {bridge.log()[-300:]!r}")
        recovered_s = time.monotonic() - since_s
        page = len(bridge.page())
        return judged(bridge, recovered_s, told, f", page {page / 1e6:.2f} MB", sound=page < 4_000_000)


def judged(bridge: BridgeProcess, recovered_s: float, told: Told, more: str = "", *, sound: bool = True) -> Seen:
    """Stop the bridge and check its memory, threads, stop time and log."""
    peak_mb, threads = bridge.peak_mb(), bridge.threads()
    stop_s = bridge.stopped_s()
    cost = f"{peak_mb:.0f} MB, {threads} threads, SIGTERM {stop_s:.1f} s{more}"
    slow = stop_s > STOP_S_MAX and stop_s > stretched(STOP_S_MAX)
    problems = (peak_mb > MEMORY_MB_MAX, threads > THREADS_MAX, slow, "Traceback" in bridge.log())
    assert sound, cost
    assert re.search(told.logged, bridge.log()), f"no {told.logged!r} in {bridge.log()[-600:]!r}"
    assert not any(problems), cost
    return Seen(None, recovered_s, f"of the real sensor nothing; {cost}", told.where)


def bad_healths(cell: Cell) -> Seen:
    """Publish each kind of number that no daemon reports."""

    def attack(bad: PublishedSensor, bridge: BridgeProcess) -> None:
        for payload in hostile_healths():
            bad.publish("health", payload)
            pause(0.02)
            bridge.page()

    return metrics(cell, attack, COUNTED)


def bad_sizes(cell: Cell) -> Seen:
    """Publish a million keys, repeatedly."""

    def attack(bad: PublishedSensor, bridge: BridgeProcess) -> None:
        payload = million_keys()
        for _ in range(3):
            bad.publish("health", payload)
        pause(3.0)
        for _ in range(3):
            bridge.page()

    return metrics(cell, attack, COUNTED)


def idle_readers(cell: Cell) -> Seen:
    """Open silent connections while another client reads."""
    with contextlib.ExitStack() as opened:

        def attack(_bad: PublishedSensor, bridge: BridgeProcess) -> None:
            opened.enter_context(idle(bridge.port, IDLE))

        return metrics(cell, attack, TURNED_AWAY)


def invented(topics: Callable[[PublishedSensor], None]) -> Callable[[PublishedSensor, BridgeProcess], None]:
    """Make an attack with many retained names of sensors that do not exist."""

    def attack(bad: PublishedSensor, _bridge: BridgeProcess) -> None:
        for number in range(NAMES):
            bad.base = f"tacshade/a{number:04d}"
            topics(bad)
        pause(2.0)

    return attack


def invented_states(cell: Cell) -> Seen:
    """Publish invented sensors that claim to be online."""
    return metrics(
        cell, invented(lambda bad: bad.publish("state", b"online", retain=True)), COUNTED_NO_ROOM, first=True
    )


# -- Foxglove -------------------------------------------------------------------------------------------------------


def watching(bridge: BridgeProcess, names: tuple[str, ...]) -> tuple[ClientConnection, bool]:
    """Connect a viewer of the real sensor; also return whether it learned of the sensor within 5 s."""
    viewer = connect(bridge.url, subprotocols=[FOXGLOVE], max_size=None, max_queue=1, compression=None)
    ids: dict[str, int] = {}
    end_s = time.monotonic() + 5
    with contextlib.suppress(TimeoutError):
        while not set(ids) >= set(names):
            told = viewer.recv(timeout=max(0.0, end_s - time.monotonic()))
            for channel in json.loads(told).get("channels", ()) if isinstance(told, str) else ():
                ids[channel["topic"].removeprefix(f"/tacshade/{REAL}/")] = channel["id"]
    wanted = [{"id": ids[name], "channelId": ids[name]} for name in names if name in ids]
    viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
    return viewer, len(wanted) == len(names)


def looked_at(bridge: BridgeProcess, sensor: PublishedSensor) -> bool:
    """Whether a new viewer gets a height map of the real sensor."""
    with contextlib.suppress(OSError, WebSocketException):
        viewer, known = watching(bridge, ("height",))
        with viewer:
            for number in range(50 if known else 0):
                sensor.show(bump(number, 1.0, 236.0, 328.0, 8))
                with contextlib.suppress(TimeoutError):
                    while not isinstance(viewer.recv(timeout=0.2), bytes):
                        pass
                    return True
    return False


def views(
    cell: Cell,
    attack: Callable[[PublishedSensor, PublishedSensor, BridgeProcess], None],
    told: Told,
    *,
    first: bool = False,
) -> Seen:
    """Attack viewers; with `first`, before the real sensor and the bridge start."""
    cell.serve()
    with contextlib.ExitStack() as opened:
        bad = opened.enter_context(PublishedSensor(cell.broker.port, "bad"))
        real = PublishedSensor(cell.broker.port, REAL)
        bridge = BridgeProcess("foxglove", cell.broker.port, cell.folder / "bridge.log")
        if first:
            attack(bad, real, bridge)
        opened.enter_context(real)
        opened.enter_context(bridge)
        if not first:
            cell.until(lambda: looked_at(bridge, real), 30, "the real sensor before")
            attack(bad, real, bridge)
        since_s = time.monotonic()
        cell.until(lambda: looked_at(bridge, real), 30, f"the real sensor, in {bridge.log()[-300:]!r}")
        return judged(bridge, time.monotonic() - since_s, told)


def bad_infos(cell: Cell) -> Seen:
    """Publish each geometry that no sensor has while a viewer shows the skin; the last one is retained."""

    def attack(bad: PublishedSensor, real: PublishedSensor, bridge: BridgeProcess) -> None:
        viewer = connect(bridge.url, subprotocols=[FOXGLOVE], max_size=None, compression=None)
        with viewer:
            ids: list[int] = []
            while len(ids) < 18:
                told = viewer.recv(timeout=5)
                ids += [c["id"] for c in json.loads(told).get("channels", ())] if isinstance(told, str) else []
            wanted = [{"id": one, "channelId": one} for one in ids]
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            for payload in hostile_infos():
                bad.publish("info", payload, retain=True)
                bad.show(bump(1, 1.0, 236.0, 328.0, 8))
                with contextlib.suppress(TimeoutError):
                    while True:
                        viewer.recv(timeout=0.01)
            pause(1.0)

    return views(cell, attack, REFUSED)


def retained_infos(cell: Cell) -> Seen:
    """Publish retained geometries before the bridge starts, then connect a viewer immediately."""

    def attack(bad: PublishedSensor, _real: PublishedSensor, _bridge: BridgeProcess) -> None:
        for number, payload in enumerate(hostile_infos()):
            bad.base = f"tacshade/b{number}"
            bad.publish("info", payload, retain=True)
        pause(1.0)

    return views(cell, attack, Told("log", r"b\d+: info: "), first=True)


def slow_viewers(cell: Cell) -> Seen:
    """Connect viewers that subscribe to the real sensor's largest height maps and read nothing."""
    with contextlib.ExitStack() as opened:

        def attack(_bad: PublishedSensor, real: PublishedSensor, bridge: BridgeProcess) -> None:
            for _ in range(VIEWERS):
                viewer, _known = watching(bridge, ("height", "cloud", "skin", "contact"))
                opened.callback(viewer.socket.close)
            result = bump(1, 2.0, 236.0, 328.0)
            payload = wire.encode_height(result, calibration_crc32=CRC)
            for _ in range(150):
                real.publish("height", payload)
                pause(0.02)

        return views(cell, attack, SLOW)


def idle_viewers(cell: Cell) -> Seen:
    """Open silent connections."""
    with contextlib.ExitStack() as opened:

        def attack(_bad: PublishedSensor, _real: PublishedSensor, bridge: BridgeProcess) -> None:
            opened.enter_context(idle(bridge.port, IDLE))

        return views(cell, attack, TURNED_AWAY)


def invented_infos(cell: Cell) -> Seen:
    """Publish invented sensors with an `info` message that decodes."""
    info = messages.encode_info(version="0", config_digest="0", profile="fast", calibration=_missing())

    def attack(bad: PublishedSensor, _real: PublishedSensor, bridge: BridgeProcess) -> None:
        invented(lambda one: one.publish("info", info, retain=True))(bad, bridge)

    return views(cell, attack, NO_ROOM, first=True)


def _missing() -> Any:
    from tacshade_edge.reasons import Reason, ReasonCode

    return Reason(ReasonCode.NOT_CALIBRATED, "not calibrated")


# -- the library ----------------------------------------------------------------------------------------------------

_LISTENER = """
import resource, sys
import tacshade_edge as ts
found = 0
with ts.listen(sys.argv[1], "right") as sensor:
    print("listens", flush=True)
    while True:
        try:
            result = next(sensor)
        except ts.TacshadeError as error:
            print("told", error, flush=True)
            continue
        if result.shear_mm is not None: assert result.shear_mm.shape == (*result.height_mm.shape, 2)
        if result.sigma_mm is not None: assert result.sigma_mm.shape == result.height_mm.shape
        if result.seq == 4242:
            break
print("ended", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024, flush=True)
"""


def listener(cell: Cell) -> Seen:
    """Publish hostile messages to a listener that uses the library."""
    cell.serve()
    with PublishedSensor(cell.broker.port, REAL) as sensor:
        words = [sys.executable, "-c", _LISTENER, f"127.0.0.1:{cell.broker.port}"]
        child = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        try:
            assert child.stdout is not None
            child.stdout.readline()
            touched = bump(1, 1.0, 236.0, 328.0, 4)
            for payload in hostile_infos():
                sensor.publish("info", payload)
                sensor.show(touched)
                pause(0.02)
            sensor.publish_info("fast", profiles=("fast",))
            for message in other_shapes():
                sensor.publish(*message)
                pause(0.02)
            since_s = time.monotonic()

            def over() -> bool:
                sensor.show(bump(4242, 1.0, 236.0, 328.0, 4))
                return child.poll() is not None

            cell.until(over, 20, "a result")
            out, errors = child.communicate()
            assert child.returncode == 0, errors[-600:]
            peak_mb = int(out.split()[-1])
            assert peak_mb < MEMORY_MB_MAX, out
        finally:
            child.kill()
            child.communicate()
    lost = f"of the real sensor nothing; {peak_mb} MB"
    return Seen(None, time.monotonic() - since_s, lost, "`passed_over`")


def other_shapes() -> Iterator[tuple[str, bytes]]:
    """Yield `shear` and `sigma` on other grids than the `height` of their frame, then `height` on invalid grids."""
    from dataclasses import replace

    from tools.testbed.published_sensor import dragged, uncertain

    for other in (bump(7, 1.0, 236.0, 328.0, 8), bump(7, 1.0, 240.0, 300.0, 6)):
        for made in (dragged(other, 1.0, 0.0), uncertain(other, 0.1)):
            touched = bump(7, 1.0, 236.0, 328.0, 4)
            yield "height", wire.encode_height(touched, calibration_crc32=CRC)
            yield "cloud", wire.encode_cloud(touched, calibration_crc32=CRC)
            if made.shear_mm is not None:
                yield "shear", wire.encode_shear(made, calibration_crc32=CRC)
            if made.sigma_mm is not None:
                yield "sigma", wire.encode_sigma(made, calibration_crc32=CRC)
            yield "contact", messages.encode_contact(touched, fps=30.0)
    touched = bump(8, 1.0, 236.0, 328.0, 4)
    for row0, step_px in ((0.0, 0.0), (0.0, -1.0), (float("nan"), 1.0), (float("inf"), 1.0), (1e30, 1e-30)):
        grid = replace(touched.height, row0=row0, step_px=step_px)
        yield "height", wire.encode_height(replace(touched, height=grid), calibration_crc32=CRC)
        yield "cloud", wire.encode_cloud(touched, calibration_crc32=CRC)
        yield "contact", messages.encode_contact(touched, fps=30.0)


FAULTS = {
    "bridge prometheus: numbers and names that no daemon tells": bad_healths,
    "bridge prometheus: a million keys": bad_sizes,
    f"bridge prometheus: {IDLE} idle connections": idle_readers,
    f"bridge prometheus: {NAMES} invented sensors": invented_states,
    "bridge foxglove: geometries that no sensor has": bad_infos,
    "bridge foxglove: such geometries, retained": retained_infos,
    f"bridge foxglove: {VIEWERS} viewers that do not read": slow_viewers,
    f"bridge foxglove: {IDLE} idle connections": idle_viewers,
    f"bridge foxglove: {NAMES} invented sensors": invented_infos,
    "library: what no daemon publishes": listener,
}
