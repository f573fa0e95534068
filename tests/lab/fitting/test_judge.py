from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
import pytest

from support.calibrated_sensor import calibrated, presses
from tacshade_edge.sensor.depth.solver import Features
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, FittedNetwork

if TYPE_CHECKING:
    from tacshade_edge.lab.fitting.judge import NetworkReport

pytestmark = [
    pytest.mark.fit,
    pytest.mark.skipif(
        find_spec("torch") is None, reason="PyTorch (the extra fit) is not installed"
    ),
]


@pytest.mark.parametrize(
    ("simulated", "pressed", "kept"),
    [
        ((0.3, 0.2), (None, None), True),
        ((0.3, 0.31), (None, None), False),
        ((0.3, 0.27), (0.3, 0.2), True),
        ((0.3, 0.2), (0.3, None), False),
        ((0.3, 0.2), (0.3, 0.32), True),
        ((0.3, 0.2), (0.3, 0.34), False),
        ((0.2, 0.3), (0.3, 0.2), False),
    ],
)
def test_a_network_is_kept_if_it_is_better_on_the_twin_and_tolerable_on_presses(
    simulated: tuple[float, float], pressed: tuple[float | None, float | None], kept: bool
) -> None:
    report = _report(*simulated, *pressed)
    assert report.kept == kept
    assert report.line.endswith("the shipped network stays") != kept


def test_weights_go_a_part_of_the_way_from_the_shipped_ones() -> None:
    from tacshade_edge.lab.fitting.judge import towards
    from tacshade_edge.lab.fitting.torch_network import TorchNetwork

    shipped = TorchNetwork("fast").flat()
    trained = shipped + np.linspace(-0.1, 0.2, len(shipped), dtype=np.float32)
    np.testing.assert_array_equal(towards("fast", trained, 0.0), shipped)
    np.testing.assert_allclose(towards("fast", trained, 0.5), (shipped + trained) / 2, atol=1e-6)
    np.testing.assert_allclose(towards("fast", trained, 1.0), trained, atol=1e-6)


def _report(*errors: float | None) -> NetworkReport:
    from tacshade_edge.lab.fitting.judge import NetworkReport as Report

    return Report("fast", *errors)  # type: ignore[arg-type]


def test_presses_of_a_fitted_sensor_are_judged_as_stated() -> None:
    from tacshade_edge.lab.fitting.judge import JudgingPresses
    from tacshade_edge.sensor.inference.network import load_network

    own = JudgingPresses(calibrated(), PROFILES["fast"], presses()[:6])
    found = own.measure(load_network("fast"))
    assert found.presses == 6
    assert 0 < found.mean_mm < 0.6
    assert found.error_scale is not None
    none = own.measure(replace(load_network("fast"), sigma=None))
    assert none.error_scale is None


def test_a_network_has_a_factor_if_every_indenter_asks_for_that_of_the_others() -> None:
    from tacshade_edge.lab.fitting.judge import JudgingPresses
    from tacshade_edge.sensor.inference.network import load_network

    network = load_network("fast")

    def deeper(white: F32, sensor: F32, features: Features | None = None) -> list[F32]:
        maps, untrusted = network.run(white, sensor, features)
        return [np.concatenate((maps[: network.fold**2] * 2, maps[network.fold**2 :])), untrusted]

    doubled = replace(network, run=deeper)
    own = [replace(press, radius_mm=5.0) for press in presses()[:12]]
    judging = JudgingPresses(calibrated(), PROFILES["fast"], own)
    alike = judging.measure(doubled)
    assert (len(alike.errors_mm), alike.factor) == (1, 1.0)
    assert judging.measure(doubled, 0.5).mean_mm < 0.6 * alike.mean_mm
    others = [replace(press, radius_mm=5.1) for press in own[6:]]
    mixed = JudgingPresses(calibrated(), PROFILES["fast"], [*own[:6], *others])
    found = mixed.measure(doubled)
    assert (len(found.errors_mm), found.presses) == (2, 12)
    assert found.factor == pytest.approx(0.5, rel=0.2)
    assert found.mean_mm < 0.5 * alike.mean_mm


@pytest.mark.parametrize(
    ("left", "kept"), [((0.4, 0.3), True), ((0.2, 0.24), True), ((0.2, 0.26), False)]
)
def test_a_network_is_kept_unless_it_explains_touches_much_less(
    left: tuple[float, float], kept: bool
) -> None:
    from tacshade_edge.lab.fitting.judge import NetworkReport

    report = NetworkReport("fast", 0.3, 0.2, shipped_left=left[0], fitted_left=left[1])
    assert report.kept == kept
    assert "of your touches unexplained" in report.line


def test_what_touches_leave_unexplained_widens_the_intervals_and_nothing_narrows_them() -> None:
    from tacshade_edge.lab.fitting.judge import USUAL_LEFT, error_scale_of, with_error_scale
    from tacshade_edge.sensor.inference.network import load_network

    sigma = load_network("fast").sigma
    assert sigma is not None
    alone = sigma.scale_without_presses
    assert error_scale_of("fast", 0.0) == error_scale_of("fast", USUAL_LEFT) == alone
    assert error_scale_of("fast", 4 * USUAL_LEFT) == pytest.approx(2 * alone)
    fitted = FittedNetwork("layout", np.zeros(1, np.float32), 0, 0.2, 0.3, error_scale=0.7 * alone)
    assert with_error_scale(fitted, "fast", 4 * USUAL_LEFT).error_scale == pytest.approx(2 * alone)
    wide = replace(fitted, error_scale=3 * alone)
    assert with_error_scale(wide, "fast", 0.1).error_scale == 3 * alone
