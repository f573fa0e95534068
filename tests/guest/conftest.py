"""These tests run inside a guest with a real kernel, systemd and udev (tools/ci/run_guest.py): as
root, with nothing to lose, some twenty times slower.
"""

from __future__ import annotations

import faulthandler
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from support.patience import patience
from support.vivid import UDEV, unload_driver

INSIDE = Path("/out/.command").exists()
OUTPUT = Path("/dev/hvc0")
TEST_S = 20.0
"""The longest test takes so long where nothing is emulated."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark every test of this folder."""
    for item in items:
        if item.path.is_relative_to(
            Path(__file__).parent
        ):  # pytest asks every conftest about every item
            item.add_marker(pytest.mark.guest)
            if not INSIDE:
                item.add_marker(pytest.mark.skip("needs a guest: python -m tools.ci.run_guest"))


@pytest.fixture(autouse=True, scope="session")
def no_udev() -> None:
    """It would open each camera that is plugged in; test_service.py, the last, starts it again."""
    subprocess.run(["systemctl", "stop", *UDEV], check=False)


@pytest.fixture(autouse=True)
def ends_if_it_hangs() -> Iterator[None]:
    """With where each thread is."""
    with OUTPUT.open("w") as output:
        faulthandler.dump_traceback_later(patience(TEST_S), exit=True, file=output)
        yield
        faulthandler.cancel_dump_traceback_later()


@pytest.fixture(scope="module", autouse=True)
def no_driver_left() -> Iterator[None]:
    yield
    unload_driver()
