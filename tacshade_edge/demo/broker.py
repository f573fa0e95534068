"""The demo's own broker on loopback: mosquitto if it is installed, else the broker from the extra `demo`."""

from __future__ import annotations

import importlib.util
import logging
import os
import shutil
import sys
from pathlib import Path

from tacshade_edge.errors import DeviceError
from tacshade_edge.version import how_to_install

_SBIN = "/usr/sbin"  # Debian's mosquitto, which is not on every user's PATH

# The broker keeps two segments of messages for each topic: enough for the newest full-size maps, not for a history.
_EMBEDDED = """\
id = 0
[router]
id = 0
max_connections = 64
max_outgoing_packet_count = 200
max_segment_size = 8388608
max_segment_count = 2
[v5.1]
name = "demo"
listen = "127.0.0.1:{port}"
next_connection_delay_ms = 1
[v5.1.connections]
connection_timeout_ms = 5000
max_payload_size = 4194304
max_inflight_count = 100
"""
_MOSQUITTO = """\
listener {port} 127.0.0.1
allow_anonymous true
persistence false
max_queued_messages 20
set_tcp_nodelay true
"""


def broker_command(folder: Path, port: int) -> list[str]:
    """Write a broker's settings into `folder` and return the command that serves MQTT 5 on this loopback port.

    Raises DeviceError if neither mosquitto nor the extra is installed.
    """
    mosquitto = shutil.which("mosquitto", path=f"{os.environ.get('PATH', os.defpath)}:{_SBIN}")
    settings = folder / ("mosquitto.conf" if mosquitto else "broker.toml")
    text = (_MOSQUITTO if mosquitto else _EMBEDDED).format(port=port)
    if mosquitto and os.getuid() == 0:
        text += "user root\n"  # a change of user clears the kernel's promise to stop it with us
    settings.write_text(text, encoding="utf-8")
    if mosquitto:
        return [mosquitto, "-c", str(settings)]
    if importlib.util.find_spec("iotcore") is None:
        expected = f"expected mosquitto or the `demo` extra's broker: {how_to_install('demo')}"
        raise DeviceError(f"demo: found no broker, {expected}")
    return [sys.executable, "-m", __name__, str(settings)]


if __name__ == "__main__":
    from iotcore import Broker

    # rumqttd logs a span of level ERROR for every message.
    logging.getLogger("rumqttd").setLevel(logging.CRITICAL)
    Broker(config_path=sys.argv[1]).run_forever()
