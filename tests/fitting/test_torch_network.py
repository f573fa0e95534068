from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.networks import float_network

from tacshade_edge.core.depth.learned import KNOWN
from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.inference.network import network_files
from tacshade_edge.inference.onnx_weights import values_of

# Found, not imported: that takes whoever only collects this two seconds.
pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"),
]


@pytest.mark.parametrize("name", ["fast", "balanced", "accurate"])
def test_it_computes_what_onnx_runtime_does(name: str, tmp_path: Path) -> None:
    import torch

    from tacshade_edge.fitting.torch_network import TorchNetwork

    shipped = float_network(name, tmp_path)
    rng, side, folded = np.random.default_rng(0), PROFILES[name].cells // shipped.fold, shipped.fold**2
    known = rng.random((folded + KNOWN, side, side), dtype=np.float32)
    white = rng.random((folded, side, side), dtype=np.float32)
    expected = shipped.run(white, shipped.sense(known))
    network = TorchNetwork(name)
    flat = np.concatenate([values_of(each) for each in network_files(name)])
    np.testing.assert_array_equal(network.flat(), flat)
    found, untrusted = network(torch.from_numpy(white)[None], torch.from_numpy(known)[None])
    np.testing.assert_allclose(found[0].detach().numpy(), expected.depth_and_contact, atol=2e-4)
    np.testing.assert_allclose(untrusted[0, 0].detach().numpy(), expected.untrusted, atol=2e-4)


def test_weights_are_loaded_in_their_order() -> None:
    from tacshade_edge.fitting.torch_network import TorchNetwork

    network = TorchNetwork("shear")
    doubled = 2 * network.flat()
    network.load(doubled)
    np.testing.assert_array_equal(network.flat(), doubled)
