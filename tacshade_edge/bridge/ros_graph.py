"""Names in the graph of ROS 2 as `rmw_zenoh` writes them, by its design document: the keys of
topics, the liveliness tokens of nodes, publishers and subscriptions, and the attachments of
messages.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from dataclasses import dataclass
from typing import Final, Literal

import xxhash

from tacshade_edge.bridge.ros_messages import RosType

TOKENS_MAX: Final = 4096
"""Tokens of others that are kept; a robot has some hundreds."""

_SPACE: Final = "@ros2_lv"
EVERYBODY: Final = f"{_SPACE}/**"
"""The key expression of all tokens, of any domain."""
_PARTS: Final = 13
_ATTACHMENT: Final = struct.Struct("<qqB16s")
_GID_BYTES: Final = 16
_TRANSIENT_LOCAL: Final = "1"
# ROS knows neither dashes nor double underscores in names.
_SEPARATORS: Final = re.compile(r"[-_]+")


@dataclass(frozen=True, slots=True)
class RosTopic:
    """A topic that a publisher offers, reliable, with this many samples kept; `latched` is
    transient local: who subscribes later gets the latest.
    """

    name: str
    kind: RosType
    depth: int
    latched: bool = False

    def key(self, domain: int) -> str:
        """The key expression of its messages."""
        return f"{domain}/{self.name.strip('/')}/{_dds_name(self.kind)}/{self.kind.rihs01}"

    def qos(self) -> str:
        """The quality of service in a token: reliability, durability, history and depth, deadline,
        lifespan, liveliness; empty where it is rmw_zenoh's default.
        """
        return f":{_TRANSIENT_LOCAL if self.latched else ''}:,{self.depth}:,:,:,,"


@dataclass(frozen=True, slots=True)
class RosNode:
    """A node without namespace and enclave, the first of its Zenoh session."""

    domain: int
    zid: str
    name: str

    def token(self) -> str:
        """Its liveliness token."""
        return self._token(0, "NN")

    def publisher_token(self, number: int, topic: RosTopic) -> str:
        """The liveliness token of its publisher with this number, from 1."""
        parts = (_mangled(topic.name), _dds_name(topic.kind), topic.kind.rihs01, topic.qos())
        return "/".join((self._token(number, "MP"), *parts))

    def _token(self, number: int, entity: Literal["NN", "MP"]) -> str:
        return f"{_SPACE}/{self.domain}/{self.zid}/0/{number}/{entity}/%/%/{_mangled(self.name)}"


def gid_of(token: str) -> bytes:
    """The global identifier of the entity that has this token."""
    high_first = xxhash.xxh3_128_digest(token.encode())
    # The lower half first, each little-endian: the whole number is.
    return high_first[::-1]


def attachment(sequence: int, wall_ns: int, gid: bytes) -> bytes:
    """What accompanies a message: its number from 1, the time of sending, its publisher."""
    return _ATTACHMENT.pack(sequence, wall_ns, _GID_BYTES, gid)


def ros_name(sensor_id: str) -> str:
    """A sensor's name as a part of the names of topics and frames: ``left-index`` is
    ``left_index``, and ``0`` is ``sensor_0``.
    """
    name = _SEPARATORS.sub("_", sensor_id).strip("_")
    return name if name[:1].isalpha() else f"sensor_{name}"


class Listeners:
    """Who subscribes to what in a domain, by the tokens that come and go; `own_zid` is this
    session, which does not count.
    """

    def __init__(self, domain: int, own_zid: str) -> None:
        self._domain, self._own = str(domain), own_zid
        self._keys: dict[str, str] = {}
        """The topic's key of each token, empty if it is no subscription in this domain."""
        self._counts: Counter[str] = Counter()

    def come(self, token: str) -> None:
        """Note a token; one that is not understood, or one too many, is none."""
        parts = token.split("/")
        if len(self._keys) >= TOKENS_MAX or len(parts) < _PARTS - 4 or parts[2] == self._own:
            return
        key = ""
        self.go(token)
        if parts[1] == self._domain and parts[5] == "MS" and len(parts) >= _PARTS:
            topic = parts[9].replace("%", "/").strip("/")
            key = f"{parts[1]}/{topic}/{parts[10]}/{parts[11]}"
        self._keys[token] = key
        self._counts[key] += 1

    def go(self, token: str) -> None:
        """Forget a token."""
        if (key := self._keys.pop(token, None)) is not None:
            self._counts[key] -= 1

    def count(self, key: str) -> int:
        """How many subscriptions a topic has, by its key."""
        return self._counts[key]

    def elsewhere(self) -> list[str]:
        """The domains of the others if there are some, but none in this one."""
        domains = {token.split("/")[1] for token in self._keys}
        return [] if self._domain in domains else sorted(domains)


def _dds_name(kind: RosType) -> str:
    package, group, name = kind.name.split("/")
    return f"{package}::{group}::dds_::{name}_"


def _mangled(name: str) -> str:
    return name.replace("/", "%")
