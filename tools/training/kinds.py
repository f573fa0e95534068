"""The kinds of simulated sensors, and how often each is made and drawn."""

from __future__ import annotations

KINDS = ("plain", "uneven", "wide", "varied", "other", "outside")
"""In shards from 0, 5000, 10000, 15000, 20000 and 25000 on."""

SHARES = (8, 2, 2, 3, 4, 6)
SHARDS_OF_A_KIND = 5000


def shards(number: int) -> list[int]:
    """List the first shards to make; the first N of them hold the kinds in `SHARES`, whatever N."""
    places = [
        ((k + 0.5) / share, SHARDS_OF_A_KIND * kind + k) for kind, share in enumerate(SHARES) for k in range(number)
    ]
    return [shard for _, shard in sorted(places)[:number]]


def kind_of(shard: int) -> str:
    """Name the kind of a shard's sensors."""
    return KINDS[shard // SHARDS_OF_A_KIND]
