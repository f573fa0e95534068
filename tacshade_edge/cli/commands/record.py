"""``tacshade-edge record``: requests a recording from the running daemon and waits
until it is complete.
"""

from __future__ import annotations

import argparse
import re
import signal
import sys
import threading
import time
from contextlib import suppress
from typing import Any

from tacshade_edge.cli.shared.options import add_config, add_option, add_sensor, number
from tacshade_edge.cli.shared.progress import Progress
from tacshade_edge.errors import DecodeError, DeviceError
from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.caller import MqttCaller
from tacshade_edge.quoting import counted
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.settings import load
from tacshade_edge.wire.codec import decode_object
from tacshade_edge.wire.requests import RECORD_NAME, RECORD_NAME_RULE, RECORD_S_MAX

# A daemon answers at once; what still waits for a slow disk when a recording ends takes longer.
ANSWER_S, WRITTEN_S, PERIOD_S = 3.0, 20.0, 0.5
STATUS = "status/recorder"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_config(parser, "the daemon's settings")
    add_sensor(parser)
    add_option(
        parser,
        "--name",
        "NAME",
        f"name of the recording: {RECORD_NAME_RULE} (default: date and time)",
        _name,
    )
    seconds = number(
        f"a number above 0 and at most {RECORD_S_MAX}", sys.float_info.min, RECORD_S_MAX
    )
    text = (
        "seconds to record; Ctrl-C stops earlier (640x480 at 30 frames/s: 6 MB/s if grey, "
        "17 MB/s in colour)"
    )
    add_option(parser, "--seconds", "N", text, seconds, required=True)


def run(args: argparse.Namespace) -> int:
    """Record.

    Raises DeviceError if anything except the time or a user ended the recording,
    or if no frame came.
    """
    document = load(args.config, args.sensor)
    links.check_broker_files(document)
    stop = threading.Event()
    for signal_number in (signal.SIGTERM, signal.SIGINT):
        # Ctrl-C ends the recording and not this command, which still has to say what was recorded.
        signal.signal(signal_number, lambda *_: stop.set())
    address, sensor_id = links.broker_address(document), document.settings.sensor_id
    caller = MqttCaller(address, sensor_id=sensor_id, verb="record", watched=(STATUS, "state"))
    try:
        caller.start()
        name = {} if args.name is None else {"name": args.name}
        folder = caller.ask({"action": "start", "seconds": args.seconds, **name}, ANSWER_S)[
            "folder"
        ]
        ended = _follow(caller, folder, args.seconds, stop)
    finally:
        caller.stop()
    dropped = f", {ended['dropped']} dropped" if ended["dropped"] else ""
    early = f" ({ended['ending']})" if ended["ending_code"] != ReasonCode.TIME else ""
    print(
        f"{folder}: {counted(ended['frames'], 'frame')}, {ended['bytes'] / 1e6:.1f} "
        f"MB{dropped}{early}"
    )
    # As `status/recorder` states it: only of an end that nobody asked for.
    if reason := ended.get("reason"):
        raise DeviceError(
            f"{folder}: the recording stopped: {reason}; the recorded frames are kept"
        )
    if ended["frames"] == 0:
        raise DeviceError(f"{folder}: the recording received no frame")
    return 0


def _name(text: str) -> str:
    if not re.match(RECORD_NAME, text):
        raise argparse.ArgumentTypeError(f"found {text!r}, expected {RECORD_NAME_RULE}")
    return text


def _follow(
    caller: MqttCaller, folder: str, seconds: float, stop: threading.Event
) -> dict[str, Any]:
    """Show the recording's progress until it is over; return the daemon's last status of it."""
    # The daemon keeps the time; one that is still silent long after it hangs or is gone.
    progress, deadline_s = Progress(), time.monotonic() + seconds + WRITTEN_S
    try:
        while not stop.is_set():
            status = _status(caller, folder)
            if (
                _over(status)
                or caller.latest("state") in (b"stopped", b"offline")
                or time.monotonic() > deadline_s
            ):
                return _last_words(caller, folder)
            progress("frames", status.get("frames", 0), None)
            caller.wait_for(stop.is_set, PERIOD_S)
        # It may have ended by itself just now; then its status says how.
        with suppress(DeviceError):
            return caller.ask({"action": "stop"}, WRITTEN_S)
        return _last_words(caller, folder)
    finally:
        progress.end()


def _last_words(caller: MqttCaller, folder: str) -> dict[str, Any]:
    """Return the last status of a recording that must be over.

    Raises DeviceError if the daemon does not report it.
    """
    if caller.wait_for(lambda: _over(_status(caller, folder)), ANSWER_S):
        return _status(caller, folder)
    state = caller.latest("state").decode() or "silent"
    found = f"the daemon is {state} and did not report how the recording ended"
    raise DeviceError(f"{folder}: {found}; the recorded frames are kept")


def _over(status: dict[str, Any]) -> bool:
    return status.get("state") in ("idle", "stopped")


def _status(caller: MqttCaller, folder: str) -> dict[str, Any]:
    """Return the ``status/recorder`` of this recording; empty until it arrives."""
    with suppress(DecodeError):
        status = decode_object(STATUS, caller.latest(STATUS) or b"{}")
        # The topic keeps the status of an earlier recording, until this one begins.
        return status if status.get("folder") == folder else {}
    return {}
