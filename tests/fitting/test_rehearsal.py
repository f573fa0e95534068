from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from tacshade_edge.core.depth.network_maps import unfold
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import load_network

# Found, not imported: that takes whoever only collects this two seconds.
pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"),
]


@pytest.mark.parametrize("name", ["fast", "balanced", "accurate"])
def test_the_frames_are_ones_that_the_network_knows(name: str) -> None:
    """It sees contacts in most, of different depths, and takes few for torn."""
    from tacshade_edge.fitting.rehearsal import rehearsal

    network = load_network(name)
    frames = rehearsal(network, PROFILES[name].cells)
    assert len(frames) >= 250
    assert int(frames.sensor.max()) == len(frames.sensors) - 1
    assert 0 <= float(frames.white.min()) < float(frames.white.max()) <= 1
    depth, torn = [], 0
    for k in range(0, len(frames), 9):
        maps = network.run(frames.white[k].numpy(), frames.sensors[frames.sensor[k]].numpy())
        height, contact = unfold(maps.depth_and_contact, network.fold)
        depth.append(height[contact > 0].max(initial=0.0))
        torn += int(np.mean(maps.untrusted > 0) > 0.2)
    assert np.mean(np.array(depth) > 0) > 0.8
    assert np.percentile(depth, 90) > 2 * np.percentile(depth, 25) > 0
    assert torn < 0.2 * len(depth)
