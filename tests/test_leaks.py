"""What comes and goes twenty times leaves nothing behind: threads, descriptors, locks, unfinished
files, shared memory and subscriptions are as many as after the first times.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from support.dashboard_process import dashboard
from support.link_rig import Rig
from support.mqtt_rig import BridgeProcess, Broker, Subscriber
from support.painted_sensor import painted_calibration, write_posed_images
from support.patience import wait_until
from support.published_sensor import PublishedSensor
from support.running_app import Live, Running
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.camera.sources import make_source
from tacshade_edge.mqtt import client
from tacshade_edge.settings import load

pytestmark = [pytest.mark.broker, pytest.mark.slow]
FIRST, TIMES = 3, 20
UNFINISHED = (".part", ".owner", ".tmp")
SUBSCRIPTIONS, UPTIME = "$SYS/broker/subscriptions/count", "$SYS/broker/uptime"
Again = Callable[[int], object]


def held(pid: int, folder: Path) -> Counter[str]:
    """What a process holds, and what lies unfinished in a folder."""
    proc = Path("/proc", str(pid))
    found = Counter(threads=len(list((proc / "task").iterdir())))
    for descriptor in (proc / "fd").iterdir():
        with contextlib.suppress(OSError):
            found[f"descriptor of {os.readlink(descriptor).partition(':')[0]}"] += 1
    found["locks"] = Path("/proc/locks").read_text().split().count(str(pid))
    found["unfinished files"] = sum(path.name.endswith(UNFINISHED) for path in folder.rglob("*"))
    found["shared memory"] = (proc / "maps").read_text().count(" /dev/shm/")
    return found


@pytest.fixture(autouse=True)
def stated(record_property: Callable[[str, object], None]) -> None:
    record_property("tried", FIRST + TIMES)


def as_before(what: Callable[[], Counter[str]], again: Again) -> None:
    """Do it a few times, and then many more, after which there is no more of anything."""
    for k in range(FIRST):
        again(k)
    before = what()
    for k in range(FIRST, FIRST + TIMES):
        again(k)
    try:
        wait_until(lambda: not what() - before, 10, "as much as before")
    except AssertionError as error:
        error.add_note(f"more: {what() - before}")
        raise


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    """One that says every second how many subscriptions it has."""
    with Broker(tmp_path, more=("sys_interval 1",)) as started:
        yield started


@pytest.fixture
def subscriptions(broker: Broker) -> Iterator[Callable[[], Counter[str]]]:
    """How many the broker has now."""
    with Subscriber(broker.port, "$SYS/broker/#") as asked:

        def counted() -> Counter[str]:
            # It says the count when that has changed, and the other each second.
            asked.wait_for(UPTIME, len(asked.of(UPTIME)) + 2, 10)
            return Counter(subscriptions=int(asked.of(SUBSCRIPTIONS)[-1]))

        yield counted


@pytest.fixture
def daemon(tmp_path: Path, broker: Broker, seen: Subscriber) -> Iterator[tuple[Live, Running]]:
    """The daemon in this process; its pictures have poses, and nothing touches."""
    write_posed_images(tmp_path / "images")
    table = tmp_path / "images/frames.csv"
    lines = [line for line in table.read_text().splitlines() if "touched" not in line]
    table.write_text("\n".join((*lines, "")))
    calibration_file.save(tmp_path / "calibration.npz", painted_calibration())
    live = Live(tmp_path, broker, seen, painted_calibration())
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        "sensor_id: hand-1\nsource: {kind: files, path: images, fps: 100, loop: true}\n"
        f"mqtt: {{host: 127.0.0.1, port: {broker.port}}}\ncalibration: calibration.npz\n"
        "recorder: {folder: recordings}\nstitching: {folder: sessions}\n"
    )
    document = load(settings)
    with live.run(make_source(document.settings.source), document) as running:
        live.until("status/camera", state="streaming")
        yield live, running


def recorded(live: Live, running: Running, k: int) -> None:
    assert live.ask("record", action="start", seconds=600, name=f"one-{k}")["ok"]
    assert live.ask("record", action="stop")["ok"]


def stitched(live: Live, running: Running, k: int) -> None:
    assert live.ask("stitch", action="begin", name=f"one-{k}")["ok"]
    assert live.ask("stitch", action="abort")["ok"]


def reloaded(live: Live, running: Running, k: int) -> None:
    before = len(live.payloads("info"))
    running.app.reload()
    wait_until(lambda: len(live.payloads("info")) > before, 10, "reloaded")


def calibrated(live: Live, running: Running, k: int) -> None:
    made = calibration_file.with_crc(replace(live.calibration, noise_grey=1 + k / 100))
    calibration_file.save(live.folder / "calibration.npz", made)
    running.app.reload()
    wait_until(
        lambda: live.last("info")["geometry"]["calibration_crc32"] == made.crc32, 10, "calibrated"
    )


def renewed(live: Live, running: Running, k: int) -> None:
    assert live.ask("reference")["ok"]


@pytest.mark.parametrize("again", [recorded, stitched, reloaded, calibrated, renewed])
def test_of_a_daemon(again: Callable[..., None], daemon: tuple[Live, Running]) -> None:
    folder = daemon[0].folder
    as_before(lambda: held(os.getpid(), folder), lambda k: again(*daemon, k))


def test_of_a_link_that_is_lost(
    tmp_path: Path, broker: Broker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client, "_RECONNECT_DELAY_S", 0.05)
    rig = Rig(broker.port).connect()

    def again(_: int) -> None:
        broker.kill()
        wait_until(lambda: not rig.link.connected, 10, "lost")
        broker.start()
        wait_until(lambda: rig.link.connected, 10, "back")

    as_before(lambda: held(os.getpid(), tmp_path), again)
    rig.link.stop(2)


def test_of_a_page(
    tmp_path: Path, broker: Broker, subscriptions: Callable[[], Counter[str]]
) -> None:
    children = Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children")
    before = set(children.read_text().split())
    with dashboard(f"127.0.0.1:{broker.port}") as address:
        (pid,) = set(children.read_text().split()) - before
        port = int(address.rstrip("/").rpartition(":")[2])

        def again(_: int) -> None:
            with Subscriber(port, "tacshade/#", page=True) as page:
                page.publish("tacshade/a/req/status", b"{}")
                page.wait_for("tacshade/a/req/status")

        pids = (int(pid), broker.pid)
        as_before(lambda: sum((held(each, tmp_path) for each in pids), subscriptions()), again)


def test_of_a_viewer(
    tmp_path: Path, broker: Broker, subscriptions: Callable[[], Counter[str]]
) -> None:
    pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
    connect = pytest.importorskip("websockets.sync.client").connect
    words = {"subprotocols": ["foxglove.sdk.v1"], "max_size": None, "close_timeout": 0.2}
    with (
        PublishedSensor(broker.port),
        BridgeProcess("foxglove", broker.port, tmp_path / "log") as bridge,
    ):

        def again(_: int) -> None:
            with connect(bridge.url, **words) as viewer:
                found: list[dict[str, object]] = []
                while not found:
                    text = viewer.recv(timeout=10)
                    found = json.loads(text).get("channels", []) if isinstance(text, str) else []
                wanted = [{"id": k, "channelId": each["id"]} for k, each in enumerate(found)]
                viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

        pids = (bridge.process.pid, broker.pid)
        as_before(lambda: sum((held(pid, tmp_path) for pid in pids), subscriptions()), again)
