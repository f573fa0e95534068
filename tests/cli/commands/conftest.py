from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext

import pytest

from tacshade_edge.cli.commands import simulate
from tacshade_edge.simulator.pad import Bar, Pad
from tacshade_edge.studies.parallel import ThisProcess


@pytest.fixture(scope="module")
def small_pad() -> Iterator[None]:
    """A touchpad of one bar, pressed in this process."""
    with pytest.MonkeyPatch.context() as patch:
        small = Pad(14.0, 10.0, (Bar(2.1, 5.1, 12.1, 5.1, 3.0),))
        patch.setattr("tacshade_edge.simulator.pad.touchpad", lambda: small)
        patch.setattr(simulate, "workers", lambda: nullcontext(ThisProcess()))
        yield
