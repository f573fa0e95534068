"""Networks for tests: functions written down; the shipped ones,
without integer graphs or read once; fitted ones.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tacshade_edge.sensor.depth import Network
from tacshade_edge.sensor.inference import network
from tacshade_edge.sensor.inference.network import (
    WEIGHTS,
    load_networks,
    network_files,
    read_network,
    read_part,
    shipped_layout,
)
from tacshade_edge.sensor.inference.onnx_weights import values_of
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import F32, Calibration, FittedNetwork

ALL_TRUSTED = np.full((28, 28), -9, np.float32)


def displaced(*given: object) -> list[F32]:
    """0.3 tenths of the disc's radius along x, NaN at one cell."""
    shear = np.stack((np.full((28, 28), 0.3, np.float32), np.zeros((28, 28), np.float32)))
    shear[0, 14, 14] = np.nan
    return [shear]


DISPLACED = Network(4, 112, lambda known: known, displaced)


def answering(fold: int, sense: Callable[[F32], F32], run: Callable[[F32, F32], F32]) -> Network:
    """Make one of a function of its own; every cell is trusted, and the skin is `displaced`."""
    return Network(
        fold,
        112,
        sense,
        lambda white, sensor, _: [run(white, sensor), ALL_TRUSTED[None]],
        DISPLACED,
    )


def saying(depth_and_contact: F32, untrusted: F32 = ALL_TRUSTED) -> Network:
    """Make one of 4x4 folded maps that says the same of every frame; the skin is `displaced`."""
    return Network(
        4, 112, lambda known: known, lambda *given: [depth_and_contact, untrusted[None]], DISPLACED
    )


def float_network(name: str, folder: Path) -> Network:
    """A network of depth."""
    return read_network(_without_integers(name, folder))


def float_shear(folder: Path) -> Network:
    """That of shear."""
    return read_part(_without_integers("shear", folder))


def _without_integers(name: str, folder: Path) -> Path:
    """A copy that has no integer graph beside it."""
    for part in (".onnx", ".sensor.onnx", ".json"):
        shutil.copy(WEIGHTS / f"{name}{part}", folder)
    return folder / f"{name}.onnx"


@cache
def _read() -> dict[str, Network]:
    return load_networks()


@pytest.fixture(autouse=True, scope="module")
def shared_networks() -> Iterator[None]:
    """As the daemon's parts share them (`preload`)."""
    network.PRELOADED.update(_read())
    yield
    network.PRELOADED.clear()


def fitted_network(profile: str, by: float = 0.0, layout: str | None = None) -> FittedNetwork:
    """The shipped weights, all of them greater by a number."""
    name = PROFILES[profile].network
    assert name is not None
    weights = np.concatenate([values_of(data) for data in network_files(name)])
    weights += np.float32(by)
    return FittedNetwork(
        layout or shipped_layout(name), weights, 8, error_mm=0.2, shipped_error_mm=0.4
    )


def fitted_with(
    profile: str, calibration: Calibration, by: float = 0.0, layout: str | None = None
) -> Calibration:
    """A calibration with `fitted_network`."""
    return replace(calibration, fitted={profile: fitted_network(profile, by, layout)})
