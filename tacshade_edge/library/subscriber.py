"""Results from a daemon on the network, each assembled from its messages when it is requested."""

from __future__ import annotations

import os
import time
from typing import Final

from paho.mqtt.client import MQTTMessage

from tacshade_edge.errors import DeviceError
from tacshade_edge.library.arguments import path_of, text_of, wrong
from tacshade_edge.library.frame_assembler import TOPICS, FrameAssembler
from tacshade_edge.library.result import Result, Results
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.subscription import Subscription, address_of
from tacshade_edge.quoting import escaped, shown
from tacshade_edge.reasons import ReasonCode
from tacshade_edge.wire.broker_address import BROKER

_SILENT_S: Final = 5.0
"""A daemon with a camera publishes ten messages a second even while nothing touches."""
_STATES_S: Final = 1.0
_REASON_CHARS_MAX: Final = 500
_ID_CHARS_MAX: Final = 255
_SENSOR_ID: Final = "the sensor_id of a daemon's settings, such as left-index"


def listen(
    broker: str,
    sensor_id: str,
    *,
    username: str | None = None,
    password: str | None = None,
    ca_file: str | os.PathLike[str] | None = None,
) -> Results:
    """Listen to a running daemon (docs/reference/mqtt.md).

    The daemon publishes a result for each frame in contact, for the end of a contact, and ten times
    a second while nothing touches. A slower reader gets the newest; others are passed over.

    Parameters
    ----------
    broker : str
        ``HOST`` or ``HOST:PORT``; the default port is 1883.
    sensor_id : str
        The `sensor_id` of the daemon's settings.
    username, password : str, optional
        Credentials for a broker that requires them.
    ca_file : path, optional
        Certificate of the authority that signed the broker's certificate; turns TLS on.

    Returns
    -------
    Results
        An iterator without an end, already subscribed. A thread receives messages until `close`;
        results are computed in the caller's thread, while ``next`` runs.

    Raises
    ------
    ConfigError
        The arguments can never work.
    DeviceError
        No broker answers, or the broker rejects the client. Later, from ``next``: no result arrived
        for 5 s, or the connection is lost, which the thread tries to restore every second.
    """
    # A wildcard would mix the frames of several sensors into one stream.
    if not 0 < len(text_of("sensor_id", sensor_id, _SENSOR_ID)) <= _ID_CHARS_MAX or set(
        sensor_id
    ) & set("/+#"):
        raise wrong("sensor_id", sensor_id, _SENSOR_ID)
    address = address_of(
        text_of("broker", broker, BROKER),
        None if username is None else text_of("username", username, "text"),
        None if password is None else text_of("password", password, "text"),
        None if ca_file is None else path_of("ca_file", ca_file),
    )
    return _Heard(address, sensor_id)


class _Heard(Results):
    def __init__(self, broker: BrokerAddress, sensor_id: str) -> None:
        self._prefix = f"tacshade/{sensor_id}/"
        # The subscription's lock guards it.
        self._frames = FrameAssembler()
        # Half of a frame from the last connection must not be completed by this one.
        forget = self._frames.forget
        self._subscription = Subscription(broker, sensor_id, TOPICS, self._take_in, forget)

    @property
    def passed_over(self) -> int:
        return self._frames.passed_over

    @property
    def refused(self) -> int:
        return self._subscription.refused

    def _next(self) -> Result | None:
        end_s = time.monotonic() + _SILENT_S
        heard = self._subscription
        with heard.changed:
            while heard.wait(lambda: self._frames.whole or heard.failed, end_s - time.monotonic()):
                if not self._frames.whole:
                    raise heard.failure()
                if (result := self._frames.take()) is not None:
                    return result
            if heard.closed:
                return None
            raise self._silence()

    def _release(self) -> None:
        self._subscription.close()

    def _take_in(self, topic: str, message: MQTTMessage) -> None:
        self._frames.add(topic.removeprefix(self._prefix), bytes(message.payload))

    def _silence(self) -> DeviceError:
        """The error for a long silence, with its cause as far as it is known. Lock held."""
        heard, frames = self._subscription, self._frames
        state, reason = shown(frames.state), escaped(frames.info.reason, _REASON_CHARS_MAX)
        known = f"the sensor's state is {state}"
        if not frames.state:
            # Retained values come at once, so a second is enough to name who is there.
            heard.ask_who_is_there()
            heard.wait(lambda: False, _STATES_S)
            there = heard.who_is_there()
            known = f"no daemon has published a state, expected one of those that have: {there}"
        text = (
            f"{heard.where}: {heard.base}: no result for {_SILENT_S:.0f} s; "
            f"{known}{'; ' * bool(reason)}{reason}"
        )
        return DeviceError(text, code=ReasonCode.NO_ANSWER)
