"""`MqttCaller` at a real broker; the daemon's side is a subscriber that answers by hand."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest

from support.mqtt_rig import Broker, Subscriber
from tacshade_edge.errors import DeviceError
from tacshade_edge.mqtt.caller import MqttCaller
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.reasons import ReasonCode

pytestmark = pytest.mark.broker
BASE = "tacshade/left"


def caller(port: int, username: str | None = None, password: str | None = None) -> MqttCaller:
    address = BrokerAddress(
        host="127.0.0.1", port=port, username=username, password=password, tls_ca=None
    )
    return MqttCaller(address, sensor_id="left", verb="record", watched=("state",))


def test_its_own_reply_is_found_among_others(tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, Subscriber(broker.port, f"{BASE}/req/#") as daemon:
        daemon.publish(f"{BASE}/state", b"online", retain=True)
        asking = caller(broker.port)
        asking.start()
        assert asking.wait_for(lambda: asking.latest("state") == b"online", 5)

        def answer(ok: bool, content: dict[str, object], number: int) -> None:
            request = json.loads(daemon.wait_for(f"{BASE}/req/record", number)[-1])
            assert request.pop("action") == "stop"
            for payload in (b"[", b"[]", b"{}", b'{"transaction": 5, "ok": true, "result": {}}'):
                daemon.publish(f"{BASE}/res/record", payload)
            daemon.publish(
                f"{BASE}/res/record", json.dumps({**request, "ok": ok, **content}).encode()
            )

        thread = threading.Thread(target=answer, args=(True, {"result": {"folder": "f"}}, 1))
        thread.start()
        assert asking.ask({"action": "stop"}, 10) == {"folder": "f"}
        thread.join()
        thread = threading.Thread(target=answer, args=(False, {"error": "found none"}, 2))
        thread.start()
        with pytest.raises(DeviceError, match="found none"):
            asking.ask({"action": "stop"}, 10)
        thread.join()
        with pytest.raises(
            DeviceError, match=r"no answer from sensor left within 0 s; is the daemon running\?"
        ):
            asking.ask({"action": "stop"}, 0.2)
        asking.stop()


def test_a_request_that_the_access_rules_deny_is_reported_at_once(tmp_path: Path) -> None:
    rules = tmp_path / "acl"
    rules.touch(0o600)
    rules.write_text("topic read tacshade/#\n")
    with Broker(tmp_path, more=(f"acl_file {rules}",)) as broker:
        asking = caller(broker.port)
        asking.start()
        denied = (
            "rejects tacshade/left/req/record: Not authorized; change the broker's access rules"
        )
        with pytest.raises(DeviceError, match=denied) as no:
            asking.ask({"action": "stop"}, 600)
        assert no.value.code is ReasonCode.REFUSED
        asking.stop()


def test_a_broker_that_does_not_let_us_in_is_reported(tmp_path: Path) -> None:
    with Broker(tmp_path, users={"hand": "secret"}) as broker:
        refused = caller(broker.port, "hand", "wrong")
        with pytest.raises(
            DeviceError,
            match=(
                rf"127\.0\.0\.1:{broker.port}: rejects the connection: Not authorized; "
                r"expected a broker"
            ),
        ) as caught:
            refused.start()
        assert caught.value.code is ReasonCode.REFUSED
        refused.stop()
        let_in = caller(broker.port, "hand", "secret")
        let_in.start()
        let_in.stop()
