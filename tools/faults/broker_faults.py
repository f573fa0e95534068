"""Faults in which the broker disappears, stalls, refuses or is shared, and requests that nobody should send."""

from __future__ import annotations

import json
import time

from tools.faults.rig import BASE, Cell, Proxy, Seen, fault, pause
from tools.testbed.mqtt_rig import Subscriber

AWAY_S = 2.0
STALL_S = 6.0
FLOOD = 5000


@fault("broker killed, and back")
def killed(cell: Cell) -> Seen:
    cell.start()
    before = cell.frames()["failed"]
    since_s = cell.mark()
    cell.broker.kill()
    detected_s = cell.told("connection lost|Connection refused", since_s)
    pause(AWAY_S)
    cell.broker.start()
    recovered_s = cell.maps_again()
    lost = cell.frames()["failed"] - before
    return Seen(f"{lost} frames, counted as failed", "log, `health.mqtt.losses`", detected_s, recovered_s)


@fault(f"broker stalls for {STALL_S:.0f} s")
def stalled(cell: Cell) -> Seen:
    """The broker neither reads nor answers, but the connection stays open."""
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
    recovered_s = cell.maps_again()
    after = cell.frames()
    superseded, failed = (after[name] - before[name] for name in ("superseded", "failed"))
    assert superseded + failed > 0
    return Seen(
        f"{superseded} frames superseded, {failed} failed, all counted", "log, `health`", detected_s, recovered_s
    )


@fault("network carries nothing")
def network_stalls(cell: Cell) -> Seen:
    cell.serve()
    proxy = cell.enter(Proxy(cell.broker.port))
    cell.start(cell.settings(port=proxy.port))
    before = cell.frames()["failed"]
    since_s = cell.mark()
    proxy.flows.clear()
    detected_s = cell.told("connection lost", since_s)
    proxy.flows.set()
    recovered_s = cell.maps_again()
    lost = cell.frames()["failed"] - before
    return Seen(f"{lost} frames, counted as failed", "log, `health.mqtt.losses`", detected_s, recovered_s)


@fault("broker denies publishing")
def denied(cell: Cell) -> Seen:
    rules = cell.folder / "acl"
    rules.write_text("topic read #\ntopic write tacshade/other/#\n")
    cell.serve(more=(f"acl_file {rules}",))
    began_s = cell.start(streams=False)
    detected_s = cell.told("Not authorized", began_s)
    cell.told("source streaming", began_s)
    assert cell.seen.of(f"{BASE}/height") == []
    return Seen("all maps, counted as failed", "log, `health.mqtt.refused`; `doctor`", detected_s)


@fault("a second daemon, same sensor_id and folders")
def same_id(cell: Cell) -> Seen:
    cell.start()
    count = cell.session()
    with cell.second("in use by") as detected_s:
        pause(3.0)
    recovered_s = cell.maps_again()
    cell.presses(count)
    return Seen("no press", "both logs", detected_s, recovered_s)


@fault("a subscriber that does not read")
def never_reading(cell: Cell) -> Seen:
    cell.start()
    before = cell.frames()["published"]
    with Subscriber(cell.broker.port) as deaf:
        deaf.client.loop_stop()
        pause(STALL_S)
        assert cell.frames()["published"] > before
    return Seen("what that subscriber did not read", "mosquitto's `$SYS`; the daemon is not concerned")


@fault(f"{FLOOD} requests at once")
def flood(cell: Cell) -> Seen:
    cell.start()
    cell.mark()
    for number in range(FLOOD):
        cell.seen.publish(f"{BASE}/req/profile", json.dumps({"profile": f"x{number}\n\x1b[31m"}).encode(), 0)

    def answered() -> bool:
        # Only a few answers may wait for the broker, so one may be missing.
        cell.seen.publish(f"{BASE}/req/status", b"{}")
        pause(0.1)
        return any(b'"ok":true' in answer for answer in cell.seen.of(f"{BASE}/res/status"))

    answered_s = cell.until(answered, 30, "an answer to a request for the status")
    cell.maps_again()
    lines = cell.new_log().splitlines()
    assert len(lines) < 60, len(lines)
    assert not any("\x1b" in line for line in lines)
    cell.frames()
    told = f"answers; {len(lines)} lines of log"
    return Seen("requests over 16 that wait, refused as busy", told, None, answered_s)
