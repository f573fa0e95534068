"""Faults in which the broker disappears, stalls, refuses, or is shared."""

from __future__ import annotations

import socket
import threading
import time

from tools.faults.rig import BASE, SENSOR_ID, Cell, Proxy, Seen, pause
from tools.testbed.mqtt_rig import Broker, Subscriber

AWAY_S = 2.0
STALL_S = 6.0


def killed(cell: Cell) -> Seen:
    """The broker is killed with SIGKILL and restarted."""
    cell.serve()
    cell.start()
    before = cell.frames()["failed"]
    since_s = cell.mark()
    cell.broker.kill()
    detected_s = cell.told("connection lost|Connection refused", since_s)
    pause(AWAY_S)
    since_s = time.monotonic()
    cell.broker.start()
    recovered_s = cell.maps_again(since_s)
    lost = cell.frames()["failed"] - before
    return Seen(detected_s, recovered_s, f"{lost} frames, counted as failed", "log, `health.mqtt.losses`")


def absent(cell: Cell) -> Seen:
    """The broker is absent when the daemon starts, and for a while after that."""
    began_s = time.monotonic()
    cell.start(streams=False)
    detected_s = cell.told("Connection refused", began_s, 30)
    cell.told("source streaming", began_s, 30)
    pause(AWAY_S)
    since_s = time.monotonic()
    cell.serve()
    return Seen(detected_s, cell.maps_again(since_s), "maps until then, counted as failed", "log; `doctor`")


def stalled(cell: Cell) -> Seen:
    """The broker neither reads nor answers for a while, but the connection stays open."""
    cell.serve()
    cell.start()
    before = cell.frames()
    since_s = cell.mark()
    cell.broker.stall()
    detected_s = None
    while (at_s := time.monotonic() - since_s) < STALL_S:
        if detected_s is None and "connection lost" in cell.new_log():
            detected_s = at_s
        pause(0.02)
    cell.broker.resume()
    recovered_s = cell.maps_again(time.monotonic())
    after = cell.frames()
    lost = {name: after[name] - before[name] for name in ("superseded", "failed")}
    assert sum(lost.values()) > 0
    text = f"{lost['superseded']} frames superseded, {lost['failed']} failed, all counted"
    return Seen(detected_s, recovered_s, text, "log, `health`")


def network_stalls(cell: Cell) -> Seen:
    """The connection to the broker carries nothing for longer than the keepalive time."""
    cell.serve()
    proxy = cell.enter(Proxy(cell.broker.port))
    cell.start(cell.settings(port=proxy.port))
    before = cell.frames()["failed"]
    since_s = cell.mark()
    proxy.stall()
    detected_s = cell.told("connection lost", since_s, 30)
    proxy.flow()
    recovered_s = cell.maps_again(time.monotonic())
    lost = cell.frames()["failed"] - before
    return Seen(detected_s, recovered_s, f"{lost} frames, counted as failed", "log, `health.mqtt.losses`")


def cut(cell: Cell) -> Seen:
    """The connection is reset."""
    cell.serve()
    proxy = cell.enter(Proxy(cell.broker.port))
    cell.start(cell.settings(port=proxy.port))
    before = cell.frames()["failed"]
    since_s = cell.mark()
    proxy.cut()
    detected_s = cell.told("connection lost", since_s)
    recovered_s = cell.maps_again(time.monotonic())
    lost = cell.frames()["failed"] - before
    return Seen(detected_s, recovered_s, f"{lost} frames, counted as failed", "log, `health.mqtt.losses`")


def no_broker(cell: Cell) -> Seen:
    """Another program listens on the broker's port and answers nonsense."""
    cell.serve()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        over = threading.Event()

        def answer() -> None:
            while not over.is_set():
                try:
                    peer, _ = listener.accept()
                except OSError:
                    return
                with peer:
                    peer.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")

        threading.Thread(target=answer, daemon=True).start()
        began_s = time.monotonic()
        cell.start(cell.settings(port=listener.getsockname()[1]), streams=False)
        detected_s = cell.told("does not answer as an MQTT 5 broker|Connection reset|lost", began_s, 30)
        over.set()
    return Seen(detected_s, None, "maps, counted as failed", "log; `doctor`")


def small_packets(cell: Cell) -> Seen:
    """The broker accepts packets of at most 5000 bytes."""
    cell.serve(more=("max_packet_size 5000",))
    began_s = cell.mark()
    cell.start()
    detected_s = cell.told("accepts packets of at most 5000 bytes", began_s, 30)
    frames = cell.frames()
    assert frames["failed"] > 0
    assert cell.last("health")["mqtt"]["losses"] == 0
    return Seen(detected_s, None, "what is larger, counted as failed; the rest goes on", "log, `health.mqtt.refused`")


def denied(cell: Cell) -> Seen:
    """The broker's access rules let this user publish only on other topics."""
    rules = cell.folder / "acl"
    rules.write_text("topic read #\ntopic write tacshade/other/#\n")
    cell.serve(more=(f"acl_file {rules}",))
    began_s = cell.mark()
    cell.start(streams=False)
    detected_s = cell.told("Not authorized", began_s, 30)
    cell.told("source streaming", began_s, 30)
    assert cell.seen.of(f"{BASE}/height") == []
    return Seen(detected_s, None, "all maps, counted as failed", "log, `health.mqtt.refused`; `doctor`")


def wrong_password(cell: Cell) -> Seen:
    """The broker requires another password."""
    (cell.folder / "word").write_text("wrong\n")
    cell.broker = Broker(cell.folder, users={SENSOR_ID: "right"})
    cell.enter(cell.broker)
    began_s = time.monotonic()
    cell.start(cell.settings(mqtt=f", username: {SENSOR_ID}, password_file: word"), streams=False)
    detected_s = cell.told("rejects the connection", began_s, 30)
    return Seen(detected_s, None, "maps, counted as failed", "log; `doctor`")


def same_id(cell: Cell) -> Seen:
    """Another daemon starts with the same sensor_id on the same files."""
    cell.serve()
    cell.start()
    count = cell.session("one")
    since_s = cell.mark()
    other = cell.spawn(cell.settings(name="other.yaml"), "other")
    try:
        cell.until(lambda: "in use by" in cell.log("other"), 15, "it is told")
        detected_s = time.monotonic() - since_s
        pause(3.0)
    finally:
        other.kill()
        other.wait()
    recovered_s = cell.maps_again(time.monotonic())
    assert cell.presses(count) >= count
    return Seen(detected_s, recovered_s, "no press", "both logs")


def same_id_elsewhere(cell: Cell) -> Seen:
    """Another daemon starts with the same sensor_id on its own files."""
    cell.serve()
    cell.start()
    count = cell.session("one")
    text = cell.settings(name="other.yaml").read_text().replace("recs}", "recs2}").replace("maps}", "maps2}")
    path = cell.folder / "other.yaml"
    path.write_text(text)
    since_s = cell.mark()
    other = cell.spawn(path, "other")
    try:
        cell.until(lambda: "another daemon, on" in cell.log("other"), 15, "it is told")
        detected_s = time.monotonic() - since_s
        pause(5.0)
        assert "connection lost" not in cell.new_log()
    finally:
        other.kill()
        other.wait()
    recovered_s = cell.maps_again(time.monotonic())
    assert cell.presses(count) >= count
    return Seen(detected_s, recovered_s, "no frame, no press", "the other's log; `doctor`; `status/rival`")


def never_reading(cell: Cell) -> Seen:
    """A client subscribes to everything but reads nothing."""
    cell.serve()
    cell.start()
    before = cell.frames()
    with Subscriber(cell.broker.port) as deaf:
        deaf.client.loop_stop()
        pause(STALL_S)
        after = cell.frames()
    published = after["published"] - before["published"]
    assert published > 0
    return Seen(None, None, "what that subscriber did not read", "mosquitto's `$SYS`; the daemon is not concerned")


FAULTS = {
    "broker killed, and back": killed,
    "broker absent at the start": absent,
    f"broker stalls for {STALL_S:.0f} s": stalled,
    "network carries nothing": network_stalls,
    "connection reset": cut,
    "something else on the broker's port": no_broker,
    "broker takes small packets only": small_packets,
    "broker denies publishing": denied,
    "wrong password": wrong_password,
    "a second daemon, same sensor_id and folders": same_id,
    "a second daemon, same sensor_id, other folders": same_id_elsewhere,
    "a subscriber that does not read": never_reading,
}
