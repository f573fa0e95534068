import hashlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from support.calibrated_sensor import calibrated, pressed, unloaded
from support.networks import fitted_network, fitted_with
from tacshade_edge.calibration.files.calibration_file import VERSION
from tacshade_edge.calibration.reference.references import rezero
from tacshade_edge.sensor.depth.learned import KNOWN, Network
from tacshade_edge.sensor.inference.network import load_network, load_networks, make_reconstructor
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.reconstruct import Reconstructor
from tacshade_edge.types import F32, Frame

WEIGHTS = resources.files("tacshade_edge.sensor.inference") / "weights"
NAMES = [name for name, profile in PROFILES.items() if profile.network]


def maps(name: str, network: Network, channels: int, seed: int = 0) -> F32:
    side = PROFILES[name].cells // network.fold
    return np.random.default_rng(seed).random((channels, side, side), dtype=np.float32)


def sensed(name: str, network: Network) -> F32:
    return network.sense(maps(name, network, network.fold**2 + KNOWN))


@pytest.mark.parametrize("name", [*NAMES, "shear"])
def test_the_weights_are_those_of_their_provenance(name: str) -> None:
    about = json.loads((WEIGHTS / f"{name}.json").read_text())
    files = [
        f"{name}{part}"
        for part in (".onnx", ".sensor.onnx", ".integer.onnx")
        if (WEIGHTS / f"{name}{part}").is_file()
    ]
    stored = {file: (WEIGHTS / file).read_bytes() for file in files}
    assert about["sha256"] == {
        file: hashlib.sha256(content).hexdigest() for file, content in stored.items()
    }
    assert sum(map(len, stored.values())) <= 2_500_000
    assert about["run_minus_torch"] <= 1e-4
    assert name == "shear" or about["cells"] == PROFILES[name].cells


def test_the_errors_are_those_of_the_shipped_weights() -> None:
    known = json.loads((WEIGHTS / "sigma.json").read_text())["networks"]
    found = {
        name: hashlib.sha256((WEIGHTS / f"{name}.onnx").read_bytes()).hexdigest() for name in NAMES
    }
    assert {name: errors["sha256"] for name, errors in known.items()} == found, (
        "run tools/training/fit_sigma.py"
    )
    for name, network in load_networks().items():
        assert network.sigma is not None
        assert network.sigma.scale_without_presses > 1.1, name  # 1.17, the least, is that of fast


@pytest.mark.parametrize("name", NAMES)
def test_the_shipped_network_answers_with_height_contact_and_what_is_untrusted(name: str) -> None:
    network = load_network(name)
    out = network.run(maps(name, network, network.fold**2), sensed(name, network))
    side = PROFILES[name].cells // network.fold
    for values, shape in zip(out, ((2 * network.fold**2, side, side), (1, 28, 28)), strict=True):
        assert values.shape == shape
        assert values.dtype == np.float32
        assert np.isfinite(values).all()


@pytest.mark.slow
def test_only_a_profile_that_needs_it_gets_a_network() -> None:
    frame = Frame(0, 0, 0, pressed("ball", 3.0).image)
    for name in PROFILES:
        assert make_reconstructor(calibrated(), PROFILES[name]).step(frame).contact
    with pytest.raises(ValueError, match="profile accurate needs a network"):
        Reconstructor(calibrated(), PROFILES["accurate"])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_fitted_network_runs_its_own_weights(name: str) -> None:
    """The shipped ones, handed in as a fit, answer as the shipped; others do not."""
    shipped = load_network(name)
    white, known = (
        maps(name, shipped, shipped.fold**2),
        maps(name, shipped, shipped.fold**2 + KNOWN),
    )
    expected = shipped.run(white, shipped.sense(known))[0]
    same, other = (
        load_network(name, fitted_network(name)),
        load_network(name, fitted_network(name, 1e-3)),
    )
    assert same.run(white, same.sense(known))[0].tobytes() == expected.tobytes()
    assert not np.allclose(other.run(white, shipped.sense(known))[0], expected)
    with pytest.raises(ValueError, match=f"fitted to another layout than that of {name}.onnx"):
        load_network(name, fitted_network(name, layout="another"))


@pytest.mark.slow
def test_a_fitted_profile_has_its_own_factor_and_keeps_its_weights_on_a_new_reference() -> None:
    frame = Frame(0, 0, 0, pressed("ball", 3.0).image)
    fitted = fitted_with("fast", calibrated())
    for factor, other in ((1.0, {}), (1.25, {"fast": 1.25})):
        own = {"fast": replace(fitted.fitted["fast"], factor=factor)}
        plain = make_reconstructor(replace(calibrated(), factors=other), PROFILES["fast"]).step(
            frame
        )
        found = make_reconstructor(replace(fitted, fitted=own), PROFILES["fast"]).step(frame)
        assert found.height.height_mm.tobytes() == plain.height.height_mm.tobytes()
    renewed = rezero(fitted, [unloaded(noise_seed=seed) for seed in range(900, 905)])
    assert renewed.fitted is fitted.fitted


def test_calibrations_are_of_the_shipped_weights() -> None:
    """A factor that was fitted to other weights is silently wrong: new weights need a new
    `VERSION`, and this line.
    """
    shipped = {
        name: json.loads((WEIGHTS / f"{name}.json").read_text())["sha256"][f"{name}.onnx"][:8]
        for name in NAMES
    }
    assert (VERSION, shipped) == (
        9,
        {"fast": "05035fe0", "balanced": "902f2ee7", "accurate": "492d6049"},
    )


RUN = """
import numpy as np
from tacshade_edge.sensor.depth.learned import KNOWN
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.sensor.inference.network import load_networks
for name, network in load_networks().items():
    side = PROFILES[name].cells // network.fold
    known = np.zeros((network.fold**2 + KNOWN, side, side), np.float32)
    network.run(known[: network.fold**2], network.sense(known))
"""


def traced(folder: Path, code: str) -> list[str]:
    """Calls that have to do with the network, without one,
    of a Python that is no test's and that has an empty home.
    """
    calls, home = folder / "calls", folder / "home"
    home.mkdir()
    places = {"TMPDIR": str(home), "HOME": str(home), "PYTHONPATH": os.pathsep.join(sys.path)}
    strace = ["strace", "-f", "-qq", "-e", "trace=network", "-o", str(calls)]
    command = ["unshare", "--map-root-user", "--net", *strace, sys.executable, "-c", code]
    done = subprocess.run(command, cwd=home, env={"PATH": os.environ["PATH"]} | places, check=False)
    if done.returncode:
        pytest.skip("strace in a network of its own does not work here")
    return calls.read_text().splitlines() + [str(path) for path in home.rglob("*")]


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed")
def test_the_library_sends_nothing_and_writes_nothing(tmp_path: Path) -> None:
    """From 1.29 on its wheels for Linux report to their maker, unless one forbids it."""
    assert traced(tmp_path, "import socket; socket.socket()") != []
    (tmp_path / "home").rmdir()
    assert traced(tmp_path, RUN) == []
