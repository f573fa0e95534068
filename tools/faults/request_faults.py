"""A permitted client sends requests that it should not."""

from __future__ import annotations

import json
import time

from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from tools.faults.rig import BASE, SENSOR_ID, Cell, Seen, pause
from tools.testbed.mqtt_rig import Subscriber
from tools.testbed.patience import patience

FLOOD = 5000


def reply_topic(cell: Cell) -> Seen:
    """A request asks for its answer on one of the sensor's own topics."""
    cell.serve()
    cell.start()
    since_s = cell.mark()
    with Subscriber(cell.broker.port, f"{BASE}/#", v5=True) as attacker:
        before = len(attacker.messages)
        for topic in ("state", "info", "req/stitch", "res", f"../{SENSOR_ID}/state"):
            properties = Properties(PacketTypes.PUBLISH)
            properties.ResponseTopic = f"{BASE}/{topic}"
            for payload in (b"{}", b"garbage"):
                attacker.publish(f"{BASE}/req/status", payload, properties=properties)
        attacker.wait_for(f"{BASE}/res/status", 10, 20)
        said = {m.topic for m in attacker.messages[before:] if b'"ok"' in m.payload and "/res/" not in m.topic}
        assert not said, said
        assert set(attacker.of(f"{BASE}/state")) <= {b"online"}
    return Seen(None, None, "nothing", f"answers are on `res/status`, in {time.monotonic() - since_s:.1f} s")


def flood(cell: Cell) -> Seen:
    """A client sends as many requests as it can."""
    cell.serve()
    cell.start()
    since_s = cell.mark()
    for number in range(FLOOD):
        cell.seen.publish(f"{BASE}/req/profile", json.dumps({"profile": f"x{number}\n\x1b[31m"}).encode(), 0)
    answered_s = 0.0
    while not answered_s:
        # Only a few answers may wait for the broker, so one may be missing.
        cell.seen.publish(f"{BASE}/req/status", b"{}")
        pause(0.1)
        if any(b'"ok":true' in answer for answer in cell.seen.of(f"{BASE}/res/status")):
            answered_s = time.monotonic() - since_s
        assert time.monotonic() < since_s + patience(30), "no answer to a request for the status"
    cell.maps_again(time.monotonic())
    lines = cell.new_log().splitlines()
    assert len(lines) < 60, len(lines)
    assert not any("\x1b" in line for line in lines)
    cell.frames()
    return Seen(None, answered_s, "requests over 16 that wait, refused as busy", f"answers; {len(lines)} lines of log")


FAULTS = {
    "an answer is wanted on the sensor's own topics": reply_topic,
    f"{FLOOD} requests at once": flood,
}
