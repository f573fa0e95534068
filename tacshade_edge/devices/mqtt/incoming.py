"""Requests received from the broker."""

from __future__ import annotations

from dataclasses import dataclass

from paho.mqtt.client import MQTTMessage

from tacshade_edge.errors import DecodeError
from tacshade_edge.protocol.requests import Request, encode_error, parse_request, parse_transaction


@dataclass(frozen=True, slots=True)
class BadRequest:
    """A rejected request. `topic`: topic for `answer`, below the base topic; None if it cannot be answered."""

    topic: str | None
    answer: bytes
    correlation: bytes | None


def read_request(base_topic: str, topic: str, message: MQTTMessage) -> Request | BadRequest:
    """Parse a message on ``req/<verb>``."""
    verb = topic.removeprefix(f"{base_topic}/req/")
    payload = bytes(message.payload)
    asked = str(getattr(message.properties, "ResponseTopic", None) or "")
    correlation = getattr(message.properties, "CorrelationData", None)
    # Only below res/: a client must not be able to make this daemon publish in the name of a hand.
    below = asked.removeprefix(f"{base_topic}/")
    sound = below != asked and len(below) > len("res/") and _may_name_a_topic(asked)
    response_topic = below if sound and below.startswith("res/") else None
    try:
        return parse_request(verb, payload, response_topic=response_topic, correlation=correlation)
    except DecodeError as error:
        answer_on = response_topic or (f"res/{verb}" if _may_name_a_topic(verb) else None)
        return BadRequest(answer_on, encode_error(parse_transaction(payload), error.reason), correlation)


def _may_name_a_topic(text: str) -> bool:
    """Whether this may be published on: a broker ends the connection for a control character, paho raises for others.

    U+FFFD is what was not UTF-8, and longer.
    """
    return text.isprintable() and not set(text) & set("+#\ufffd")
