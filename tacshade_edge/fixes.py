"""How a person fixes what the daemon reports about broker, camera and frames,
for its log and for `doctor`.
"""

from __future__ import annotations

import socket
import ssl
from typing import Final

from tacshade_edge.reasons import Reason, ReasonCode

_RELIGHT = (
    "restore the light and source.exposure to what they were at calibration, or calibrate again"
)
END_THE_OTHER = "end the other program that uses it; tacshade-edge doctor names it"

OF_FRAMES = {
    ReasonCode.SIZE: (
        "set source.width_px and height_px to the calibration's, or calibrate again at this size"
    ),
    ReasonCode.BLACK: "switch the sensor's light on",
    ReasonCode.NO_CONTRAST: "switch the sensor's light on; is the camera in focus?",
    ReasonCode.SATURATED: (
        "dim the sensor's light, or lower source.exposure to what it was at calibration"
    ),
    ReasonCode.LIGHT: _RELIGHT,
    ReasonCode.LIGHT_DRIFT: _RELIGHT,
    ReasonCode.GLARE: "outside light enters the sensor or reflects in it: shade it",
    ReasonCode.NOISE: "use more light and less gain, and check the camera's cable",
    ReasonCode.CAMERA_SHIFT: (
        "fasten the camera where it was, take a new reference (calibrate --rezero), "
        "or calibrate again"
    ),
    ReasonCode.SURROUND: (
        "the camera or its light moved: fasten it where it was, or calibrate again"
    ),
    ReasonCode.TORN: (
        "frames are damaged on the way: try another USB port, a shorter cable or a lower rate"
    ),
}

MESSAGE_SIZE_FIX = (
    "raise message_size_limit and max_packet_size in the broker's configuration to at least "
    "1000000 bytes, or remove them"
)
BROKERS_LOG = "see the broker's log: sudo journalctl -u mosquitto"


def with_fix(reason: Reason, fix: str | None) -> str:
    """Return a log line: what is wrong and, if known, how to fix it."""
    return f"{reason}; to fix it: {fix}" if fix else str(reason)


def connect_fix(error: BaseException | None, host: str, port: int, tls_ca: str | None) -> str:
    """Return what to do about a broker that could not be reached."""
    match error:
        case socket.gaierror():
            return (
                "is mqtt.host spelled correctly, and is the network up? Try: getent hosts " + host
            )
        case ssl.SSLError():
            authority = (
                "is mqtt.ca_file the PEM file of the CA that signed the broker's certificate"
            )
            asked = (
                f"{authority}, is {host} a name in it (subjectAltName), "
                "and is this machine's clock right?"
            )
            return f"{asked} If the port does not use TLS, omit mqtt.ca_file"
        # Before the wider ConnectionError below, of which this is a kind.
        case ConnectionRefusedError() if host in ("localhost", "127.0.0.1", "::1"):
            install = "sudo apt install mosquitto"
            return (
                "start the broker: sudo systemctl enable --now mosquitto (install it first: "
                f"{install})"
            )
        case ConnectionRefusedError():
            return (
                "is the broker running, and does it accept other machines on mqtt.port (mosquitto: "
                "`listener`)?"
            )
        # A TLS handshake with a port that does not speak TLS ends in any of these.
        case ConnectionError() | EOFError() | TimeoutError() if tls_ca:
            return (
                "is mqtt.port the broker's TLS port (often 8883)? If it does not use TLS, "
                "omit mqtt.ca_file"
            )
        case TimeoutError():
            return (
                "is the address right, is the machine on, "
                f"and is its firewall open for port {port}?"
            )
    return "is the network up, and is mqtt.host right?"


def no_answer_fix(tls_ca: str | None) -> str:
    """Return what to do about a server that accepts connections but does not answer as a broker."""
    asked = "is mqtt.port the port of an MQTT broker (1883)?"
    return asked if tls_ca else f"{asked} If the port is a TLS port (8883), set mqtt.ca_file"


# Reason codes of CONNACK (MQTT 5, 3.2.2.2).
_UNSUPPORTED_VERSION: Final = 0x84
_BAD_USER_NAME_OR_PASSWORD: Final = 0x86
_NOT_AUTHORISED: Final = 0x87
CLIENTS_FIX: Final = "raise max_connections in the broker's configuration, or end another client"
_REFUSAL_FIXES: Final = {
    _UNSUPPORTED_VERSION: "use mosquitto 1.6 or newer",  # the first one with MQTT 5
    0x88: CLIENTS_FIX,
    0x89: CLIENTS_FIX,
    0x95: MESSAGE_SIZE_FIX,
    0x97: CLIENTS_FIX,
    0x9A: "set retain_available true in the broker's configuration, or remove the line",
    0x9B: "set max_qos to at least 1 in the broker's configuration, or remove the line",
}


def is_not_authorised(code: int) -> bool:
    """Whether the reason code of the broker's CONNACK means that it rejects the user."""
    # A wrong password may be either; mosquitto says the second.
    return code in (_BAD_USER_NAME_OR_PASSWORD, _NOT_AUTHORISED)


def is_other_version(code: int) -> bool:
    """Whether the reason code of the broker's CONNACK means that it does not support MQTT 5."""
    return code == _UNSUPPORTED_VERSION


def refusal_fix(code: int, username: str | None) -> str:
    """Return what to do about a broker that answers CONNECT with this reason code."""
    if is_not_authorised(code) and username is None:
        return "the broker requires a user: set mqtt.username and mqtt.password_file"
    if is_not_authorised(code):
        return (
            "is the password right? To reset it: sudo mosquitto_passwd "
            f"/etc/mosquitto/tacshade.passwd {username}"
        )
    return _REFUSAL_FIXES.get(code, BROKERS_LOG)
