from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from support.float_network import float_network

from tacshade_edge.core.depth.network_maps import KNOWN
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

    shipped, (frame, _) = float_network(name, tmp_path), network_files(name)
    rng, side, folded = np.random.default_rng(0), PROFILES[name].cells // shipped.fold, shipped.fold**2
    sensor = shipped.sense(rng.random((folded + KNOWN, side, side), dtype=np.float32))
    white = rng.random((folded, side, side), dtype=np.float32)
    expected = shipped.run(white, sensor)
    network = TorchNetwork(frame, [sensor], 1.0)
    np.testing.assert_array_equal(network.flat(), values_of(frame))
    found, untrusted = network(torch.from_numpy(white)[None])
    np.testing.assert_allclose(found[0].detach().numpy(), expected.depth_and_contact, atol=2e-4)
    np.testing.assert_allclose(untrusted[0, 0].detach().numpy(), expected.untrusted, atol=2e-4)
    half = TorchNetwork(frame, [sensor], 0.5)(torch.from_numpy(white)[None])[0][0].detach().numpy()
    np.testing.assert_allclose(half[:folded], 0.5 * expected.depth_and_contact[:folded], atol=2e-4)
    np.testing.assert_allclose(half[folded:], expected.depth_and_contact[folded:], atol=2e-4)


def test_what_was_copied_comes_back() -> None:
    import torch

    from tacshade_edge.fitting.torch_network import TorchNetwork

    network = TorchNetwork(network_files("fast")[0], [np.zeros((32, 14, 14), np.float32)], 1.0)
    copied, before = network.copy(), network.flat()
    with torch.no_grad():
        for each in network.parameters():
            each += 1
    assert not np.array_equal(network.flat(), before)
    network.restore(copied)
    np.testing.assert_array_equal(network.flat(), before)
    assert not network.correction.detach().numpy().any()
