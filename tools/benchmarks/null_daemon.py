"""A daemon that publishes ready bytes and reconstructs nothing: it costs only Python and transport.

``tools.benchmarks.daemon`` starts it: it has the link, ledger and frame rate of the real daemon,
and publishes what the real one made from the same images, with each frame's own number and times.
"""

from __future__ import annotations

import json
import pickle
import signal
import struct
import sys
import threading
import time
import zlib
from pathlib import Path

from tacshade_edge.mqtt import links
from tacshade_edge.mqtt.outgoing import PayloadOutcome
from tacshade_edge.pipeline.ledger import FrameLedger
from tacshade_edge.settings import load

CONTACT_PERIOD_NS = 100_000_000


def stamped(message: bytes, seq: int, t_ns: int) -> bytes:
    """A height or cloud message with another frame's number and time."""
    changed = bytearray(message)
    struct.pack_into("<I", changed, 8, seq)
    struct.pack_into("<QQ", changed, 16, t_ns, time.time_ns())
    struct.pack_into(
        "<I",
        changed,
        88,
        zlib.crc32(memoryview(changed)[96:], zlib.crc32(memoryview(changed)[:88])),
    )
    return bytes(changed)


def main() -> None:
    """Publish until SIGTERM."""
    config, fps, ready = Path(sys.argv[1]), float(sys.argv[2]), Path(sys.argv[3])
    payloads: list[tuple[bytes, bytes] | None] = pickle.loads(ready.read_bytes())
    period_ns = round(1e9 / fps)
    ledger = FrameLedger()

    def settle(stream: str, seq: int, outcome: PayloadOutcome) -> None:
        if stream == "height":
            ledger.settle(seq, "failed" if outcome == "refused" else outcome)

    link = links.make_link(
        load(config),
        on_request=lambda request: None,
        on_outcome=settle,
    )
    stop = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: stop.set())
    link.start()
    zero_ns, seq, contact_ns = time.monotonic_ns(), 0, 0
    while not stop.is_set():
        seq = max(seq + 1, (time.monotonic_ns() - zero_ns) // period_ns)
        t_ns = zero_ns + seq * period_ns
        time.sleep(max(t_ns - time.monotonic_ns(), 0) / 1e9)
        ledger.captured(seq)
        pair = payloads[seq % len(payloads)]
        if pair is not None:
            link.offer("height", stamped(pair[0], seq, t_ns), seq)
            link.offer("cloud", stamped(pair[1], seq, t_ns), seq)
        else:
            ledger.settle(seq, "without_contact")
        if pair is not None or t_ns - contact_ns >= CONTACT_PERIOD_NS:
            contact_ns = t_ns
            link.offer(
                "contact",
                json.dumps({"t_ns": t_ns, "seq": seq, "contact": int(pair is not None)}).encode(),
                seq,
            )
    ledger.close(1.0)
    link.set_retained("health", json.dumps({"frames": ledger.counts().as_dict()}).encode(), qos=0)
    link.stop(1.0)


main()
