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
    found, untrusted = network(torch.from_numpy(white)[None], network.sensors[0])
    np.testing.assert_allclose(found[0].detach().numpy(), expected.depth_and_contact, atol=2e-4)
    np.testing.assert_allclose(untrusted[0, 0].detach().numpy(), expected.untrusted, atol=2e-4)
    halved = TorchNetwork(frame, [sensor], 0.5)
    half = halved(torch.from_numpy(white)[None], halved.sensors[0])[0][0].detach().numpy()
    np.testing.assert_allclose(half[:folded], 0.5 * expected.depth_and_contact[:folded], atol=2e-4)
    np.testing.assert_allclose(half[folded:], expected.depth_and_contact[folded:], atol=2e-4)


def test_scales_and_biases_are_all_that_training_changes() -> None:
    from tacshade_edge.fitting.torch_network import TorchNetwork

    frame = network_files("fast")[0]
    network, was = TorchNetwork(frame, [np.zeros((32, 14, 14), np.float32)], 1.0), values_of(frame)
    with np.errstate(divide="ignore", invalid="ignore"):
        for each in network.parameters():
            each.data *= 2
        ratio = network.flat() / was
    assert sum(each.numel() for each in network.parameters()) < len(was) / 30
    assert set(np.unique(ratio[np.isfinite(ratio)])) == {2.0}
