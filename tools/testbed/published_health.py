"""A `health` as a daemon makes it."""

from __future__ import annotations

from tacshade_edge.daemon.pipeline.ledger import FrameLedger, Timings
from tacshade_edge.daemon.publishing.health import Health
from tacshade_edge.protocol import json_payload


def health() -> bytes:
    """A `health` after three frames, one of them invalid."""
    ledger, timings = FrameLedger(), Timings()
    for seq in range(3):
        ledger.captured(seq)
    ledger.settle(0, "published")
    ledger.settle(1, "invalid")
    timings.add({"latency": 20.0, "solve": 5.0})
    told = Health(ledger, timings).snapshot(4, {"published": 9, "refused": 0})
    parts = {"recorder": {"written": 5, "waiting": 1}, "budget": None}
    return json_payload.encode_json(
        {**told, **parts, "reference": {"state": "following"}, "invalid_reason_code": "torn"}
    )
