import hashlib
import json
from importlib import resources

import numpy as np
import pytest
from calibrated_sensor import calibrated, pressed

from tacshade_edge.core.profiles import PROFILES
from tacshade_edge.core.reconstruct import Reconstructor
from tacshade_edge.core.solvers.accurate import Network
from tacshade_edge.devices.network import load_network, make_reconstructor
from tacshade_edge.types import F32, Frame

WEIGHTS = resources.files("tacshade_edge.core.solvers") / "weights"


def maps(seed: int = 0) -> F32:
    return np.random.default_rng(seed).random((14, 56, 56), dtype=np.float32)


@pytest.fixture(scope="module")
def network() -> Network:
    return load_network()


def test_the_weights_are_those_of_their_provenance() -> None:
    about = json.loads((WEIGHTS / "accurate.json").read_text())
    stored = (WEIGHTS / "accurate.onnx").read_bytes()
    assert about["sha256"] == hashlib.sha256(stored).hexdigest()
    assert about["bytes"] == len(stored) <= 1_000_000
    assert about["opencv_minus_torch"] <= 1e-4


def test_the_shipped_network_answers_with_height_and_contact(network: Network) -> None:
    out = network(maps())
    assert out.shape == (8, 56, 56)
    assert out.dtype == np.float32
    assert np.isfinite(out).all()


def test_an_answer_stays_when_the_next_is_given(network: Network) -> None:
    first = network(maps(0))
    before = first.tobytes()
    network(maps(1))
    assert first.tobytes() == before == network(maps(0)).tobytes()


def test_only_the_profile_that_needs_it_gets_a_network() -> None:
    frame = Frame(0, 0, 0, pressed("ball", 3.0).image)
    assert make_reconstructor(calibrated(), PROFILES["fast"]).step(frame).contact
    assert make_reconstructor(calibrated(), PROFILES["accurate"]).step(frame).contact
    with pytest.raises(ValueError, match="profile accurate needs a network"):
        Reconstructor(calibrated(), PROFILES["accurate"])
    with pytest.raises(ValueError, match="profile fast has no network"):
        make_reconstructor(calibrated(), PROFILES["fast"]).inverse(frame.image)
