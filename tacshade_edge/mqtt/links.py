"""The link to the broker that the settings name, and the checks that need no connection."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tacshade_edge.errors import ConfigError
from tacshade_edge.mqtt.client import BrokerAddress
from tacshade_edge.mqtt.link import MqttLink
from tacshade_edge.mqtt.outgoing import PayloadOutcome
from tacshade_edge.regular_files import decoded, read_regular
from tacshade_edge.settings import Document, Hand
from tacshade_edge.wire.requests import Request

_PASSWORD_BYTES_MAX = 1 << 16


def read_password(document: Document) -> str | None:
    """The first line of the password file; None without a file. Raises ConfigError."""
    mqtt = document.settings.mqtt
    if mqtt.password_file is None:
        return None
    where = document.where("mqtt", "password_file")
    if mqtt.username is None:
        raise ConfigError(f"{where}: found a password without a user name, expected both")
    return password_in(mqtt.password_file, where)


def password_in(path: str | Path, where: str) -> str:
    """The first line of a password file; `where` begins each error. Raises ConfigError."""
    try:
        # Bounded, and only a regular file: a pipe or a device may never end.
        text = decoded(read_regular(path, _PASSWORD_BYTES_MAX))
        password = text.partition("\n")[0].rstrip("\r")
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError(
            f"{where}: {path}: {reason}; expected a file that contains the password"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{where}: {path}: found bytes that are not UTF-8, expected a password in UTF-8"
        ) from error
    if "\0" in password:
        # UTF-16 without its mark, or a file whose content a power cut took: no broker accepts it.
        raise ConfigError(f"{where}: {path}: found zero bytes, expected a password in UTF-8")
    if not password:
        raise ConfigError(f"{where}: {path}: found an empty first line, expected the password")
    return password


def check_broker_files(document: Document) -> None:
    """Check the files that the broker's settings name. Raises ConfigError."""
    mqtt = document.settings.mqtt
    if mqtt.ca_file is not None and not Path(mqtt.ca_file).is_file():
        raise ConfigError(
            f"{document.where('mqtt', 'ca_file')}: found no file {mqtt.ca_file}, expected a PEM "
            "file with certificates"
        )
    read_password(document)


def make_link(
    of: Document | Hand,
    on_request: Callable[[Request], None],
    on_outcome: Callable[[str, int, PayloadOutcome], None],
) -> MqttLink:
    """Make the link of a sensor, or of a hand, to the broker that the settings name,
    without starting it.

    Raises ConfigError.
    """
    if isinstance(of, Hand):
        document, topic, client = of.common, f"hand/{of.hand_id}", f"hand.{of.hand_id}"
    else:
        document, topic, client = of, of.settings.sensor_id, of.settings.sensor_id
    try:
        return MqttLink(
            broker_address(document),
            base_topic=f"tacshade/{topic}",
            client_id=f"tacshade-{client}",
            on_request=on_request,
            on_outcome=on_outcome,
        )
    except ConfigError as error:
        raise ConfigError(f"{document.where('mqtt')}: {error}") from error


def check_link(of: Document | Hand) -> None:
    """Make the link that `run` makes without starting it: this also finds a wrong certificate.

    Raises ConfigError.
    """
    check_broker_files(of.common if isinstance(of, Hand) else of)
    make_link(of, on_request=lambda _: None, on_outcome=lambda *_: None)


def broker_address(document: Document) -> BrokerAddress:
    """The address of the broker that the settings name, with the password. Raises ConfigError."""
    mqtt = document.settings.mqtt
    return BrokerAddress(
        host=mqtt.host,
        port=mqtt.port,
        username=mqtt.username,
        password=read_password(document),
        tls_ca=mqtt.ca_file,
    )
