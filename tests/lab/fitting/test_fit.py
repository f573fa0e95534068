"""A short fit of a simulated sensor; what a whole one is worth is measured
by tools/studies/fit.py.
"""

from __future__ import annotations

import multiprocessing
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from support.calibrated_sensor import (
    PIN_LENGTH_MM,
    TACTIP,
    calibrated,
    found_prints,
    unloaded,
)
from support.networks import float_network
from support.patience import wait_until
from tacshade_edge.errors import ConfigError
from tacshade_edge.sensor.depth.learned import KNOWN
from tacshade_edge.sensor.inference.network import make_reconstructor, network_files, runtime
from tacshade_edge.sensor.inference.onnx_weights import values_of
from tacshade_edge.sensor.profiles import DEFAULT, LADDER, PROFILES
from tacshade_edge.types import Calibration, Frame

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.fit import FitResult


# Found, not imported: that takes whoever only collects this two seconds.
pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(
        find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"
    ),
]


def without_presses() -> Calibration:
    return replace(calibrated(), factors={}, error_scales={}, fit=None)


def short_fit(
    monkeypatch: pytest.MonkeyPatch, said: list[str], folder: Path | None = None, steps: int = 3
) -> FitResult:
    from tacshade_edge.lab.fitting import fit as module
    from tacshade_edge.lab.fitting.twin_work import Effort

    short = Effort(batches=2, held_out=1, skins=2, views=1, steps=steps)
    monkeypatch.setattr(module, "FULL", short)
    monkeypatch.setattr("tacshade_edge.lab.fitting.twin_work._SAY_S", 0.05)
    monkeypatch.setattr(module, "identify", lambda *_: found_prints())
    say = said.append if isinstance(said, list) else said
    return module.fit(without_presses(), [], say, {"pin_length_mm": PIN_LENGTH_MM}, folder)


@pytest.mark.slow
def test_a_fit_needs_no_press_and_says_what_it_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder, said = tmp_path / "fit", []
    folder.mkdir()
    (folder / "fit-of-mine.txt").touch()
    (folder / "fit-0123456789abcdef-fast.npz").touch()  # of another fit
    result = short_fit(monkeypatch, said, folder)
    assert [report.name for report in result.networks] == [DEFAULT, "accurate", "fast"]
    assert set(result.calibration.fitted) == {
        report.name for report in result.networks if report.kept
    }
    assert "pins 3.04 mm long as stated" in result.found[0]
    assert "markers that merge" in result.found[0]
    assert said[0] == "fit: finding the print in the reference"
    assert any(line.startswith("fit: simulating, 100 % done") for line in said)
    assert [path.name for path in folder.iterdir()] == ["fit-of-mine.txt"]
    frame = Frame(0, 0, 0, unloaded())
    assert make_reconstructor(result.calibration, PROFILES[DEFAULT]).step(frame).valid


@pytest.mark.slow
def test_an_interrupted_fit_leaves_no_worker_and_goes_on(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(line: str) -> None:
        if line.startswith("fit: training"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        short_fit(monkeypatch, interrupt, tmp_path / "fit", steps=400)
    wait_until(lambda: not multiprocessing.active_children(), 10, "the workers ended")
    kept = sorted(path.name[21:] for path in (tmp_path / "fit").glob("fit-*-frames-*.npz"))
    assert kept == ["frames-0.npz", "frames-1.npz"]
    said: list[str] = []
    monkeypatch.setattr(
        "tacshade_edge.lab.fitting.training.train", None
    )  # in this process, which does not train
    with pytest.raises(KeyboardInterrupt):
        short_fit(
            monkeypatch,
            lambda line: (said.append(line), interrupt(line)),
            tmp_path / "fit",
            steps=400,
        )
    assert not any("simulating, " in line for line in said)


@pytest.mark.parametrize("residual", [None, 0.6])
def test_a_reference_that_no_print_explains_is_not_fitted_without_touches(
    monkeypatch: pytest.MonkeyPatch, residual: float | None
) -> None:
    from tacshade_edge.lab.fitting import fit as module
    from tacshade_edge.lab.fitting.words import MORE_TOUCHES

    found = [] if residual is None else [replace(found_prints()[0], residual=residual)]
    monkeypatch.setattr(module, "identify", lambda *_: found)
    result = module.fit(without_presses(), [], lambda _: None)
    assert not result.calibration.fitted
    assert "nothing is fitted" in result.found[0]
    assert result.advice == (MORE_TOUCHES,)


def test_touches_that_no_print_explains_are_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    from tacshade_edge.lab.fitting import fit as module

    own = calibrated(TACTIP, 0)
    monkeypatch.setattr(module, "identify", lambda *_: [])
    still = np.rot90(own.reference_grey[:, 40:280], 1)
    turned = own.reference_grey.copy()
    turned[:, 40:280] = still  # no skin moves so
    result = module.fit(own, [], lambda _: None, touches=[turned] * 8)
    assert not result.calibration.fitted
    assert "of the touches' changes unexplained: nothing is fitted" in result.found[0]
    assert set(result.calibration.error_scales) == set(LADDER)


@pytest.mark.parametrize(
    ("left", "has_presses", "is_refused"),
    [(0.33, False, False), (0.6, False, True), (0.6, True, False), (0.95, True, True)],
)
def test_without_labels_a_print_must_explain_half_of_what_touches_change(
    left: float, has_presses: bool, is_refused: bool
) -> None:
    from tacshade_edge.lab.fitting.words import refused

    choice: Any = SimpleNamespace(left=left)
    reasons = refused(found_prints(), choice, has_presses=has_presses)
    assert bool(reasons) == is_refused
    assert not is_refused or ("press twenty balls" in reasons[1]) != has_presses


def test_too_few_touches_are_a_mistake_of_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    from tacshade_edge.lab.fitting import fit as module

    monkeypatch.setattr(module, "identify", lambda *_: found_prints())
    with pytest.raises(ConfigError, match="found 0 pictures with a touch among 9"):
        module.fit(without_presses(), [], lambda _: None, touches=[unloaded()] * 9)


@pytest.mark.parametrize("unexplained", [0.25, 0.9])
def test_a_stated_print_that_the_reference_contradicts_is_not_fitted(
    monkeypatch: pytest.MonkeyPatch, unexplained: float
) -> None:
    from tacshade_edge.lab.fitting import fit as module

    shown = replace(found_prints()[0], residual=0.2)
    monkeypatch.setattr(
        module,
        "identify",
        lambda _, stated=None: [replace(shown, residual=unexplained)] if stated else [shown],
    )
    result = module.fit(without_presses(), [], lambda _: None, {"pin_length_mm": 9.0})
    assert not result.calibration.fitted
    assert result.found[0].startswith(
        f"the stated print leaves {100 * unexplained:.0f} % of the reference unexplained"
    )
    assert "mm long" in result.found[1]
    assert "20 % of the pattern unexplained" in result.found[1]


@pytest.mark.parametrize("name", ["fast", "balanced", "accurate"])
def test_it_computes_what_onnx_runtime_does(name: str, tmp_path: Path) -> None:
    import torch

    from tacshade_edge.lab.fitting.torch_network import TorchNetwork

    shipped = float_network(name, tmp_path)
    rng, side, folded = (
        np.random.default_rng(0),
        PROFILES[name].cells // shipped.fold,
        shipped.fold**2,
    )
    known = rng.random((folded + KNOWN, side, side), dtype=np.float32)
    white = rng.random((folded, side, side), dtype=np.float32)
    # `sense` rounds what this file computes (tests/sensor/inference/test_sensor_layer.py);
    # a fit does not.
    of_sensor = runtime().InferenceSession(
        network_files(name)[1], providers=["CPUExecutionProvider"]
    )
    sensor = of_sensor.run(None, {"known": known[None]})[0][0]
    expected, expected_untrusted = shipped.run(white, sensor)
    network = TorchNetwork(name)
    flat = np.concatenate([values_of(each) for each in network_files(name)])
    np.testing.assert_array_equal(network.flat(), flat)
    found, untrusted = network(torch.from_numpy(white)[None], torch.from_numpy(known)[None])
    np.testing.assert_allclose(found[0].detach().numpy(), expected, atol=2e-4)
    np.testing.assert_allclose(untrusted[0].detach().numpy(), expected_untrusted, atol=2e-4)


def test_weights_are_loaded_in_their_order() -> None:
    from tacshade_edge.lab.fitting.torch_network import TorchNetwork

    network = TorchNetwork("fast")
    doubled = 2 * network.flat()
    network.load(doubled)
    np.testing.assert_array_equal(network.flat(), doubled)
