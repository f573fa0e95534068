"""What is known of objects by name: descriptions of the touches that taught them."""

from __future__ import annotations

from tacshade_edge.types.geometry import F32, frozen


@frozen
class KnownObject:
    """An object's name, and a description of each touch that taught it: float32 (n, D), n at least
    1.
    """

    name: str
    touches: F32
