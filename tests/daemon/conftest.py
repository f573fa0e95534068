"""A scripted frame source: the outside, behind our own interface."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from support import calibrated_sensor
from support.mqtt_rig import Broker, Subscriber
from support.painted_sensor import BLACK, FREE, TOUCHED, painted_calibration
from support.patience import wait_until
from support.running_app import Live
from support.session_rig import Robot
from tacshade_edge.daemon import app, sensor_state
from tacshade_edge.errors import TacshadeError
from tacshade_edge.types import U8, Calibration, Frame, Reconstruction

Step = U8 | TacshadeError | Callable[[], None] | None


class ScriptedSource:
    """Plays one script per opening: an image is a frame, an error is raised, a callable is called,
    None ends.

    An error as a whole script is raised by `open`; a script that is used up loses the device.
    """

    def __init__(self, *scripts: Iterable[Step] | TacshadeError) -> None:
        self._scripts = iter(scripts)
        self._steps: Iterator[Step] = iter(())
        self._seq = 0
        self.dropped = self.skipped = 0
        self.opened_ns: list[int] = []
        self.is_open = False

    def open(self) -> None:
        self.opened_ns.append(time.monotonic_ns())
        script = next(self._scripts, [None])
        if isinstance(script, TacshadeError):
            raise script
        self._steps = iter(script)
        self.is_open = True

    def read(self) -> Frame | None:
        for step in self._steps:
            if isinstance(step, TacshadeError):
                raise step
            if step is None:
                return None
            if callable(step):
                step()
                continue
            self._seq += 1
            return Frame(
                seq=self._seq - 1, t_ns=time.monotonic_ns(), wall_ns=time.time_ns(), image=step
            )
        raise AssertionError("the script of this opening is used up; end it with None or an error")

    def skip(self) -> bool:
        self.skipped += 1
        return self.read() is not None

    def close(self) -> None:
        self.is_open = False

    def describe(self) -> dict[str, str | int | float]:
        return {"script": "test"}


@pytest.fixture(scope="session")
def calibration() -> Calibration:
    return painted_calibration()


@dataclass(frozen=True)
class Pictures:
    free: U8 = field(default_factory=lambda: FREE)
    touched: U8 = field(default_factory=lambda: TOUCHED)
    black: U8 = field(default_factory=lambda: BLACK)


@pytest.fixture(scope="session")
def pictures() -> Pictures:
    return Pictures()


@pytest.fixture(name="wait_until")
def wait_until_fixture() -> Callable[..., None]:
    return wait_until


@pytest.fixture
def scripted() -> type[ScriptedSource]:
    return ScriptedSource


@pytest.fixture
def live(
    tmp_path: Path,
    broker: Broker,
    seen: Subscriber,
    calibration: Calibration,
    monkeypatch: pytest.MonkeyPatch,
) -> Live:
    monkeypatch.setattr(app, "HEALTH_PERIOD_S", 0.2)
    monkeypatch.setattr(sensor_state, "STALL_S", 0.8)
    return Live(tmp_path, broker, seen, calibration)


numbers = itertools.count()


@pytest.fixture
def link() -> Iterator[Path]:
    """A place under /dev, as the settings want, that needs no root."""
    path = Path(f"/dev/shm/tacshade-test-{os.getpid()}-{next(numbers)}")
    yield path
    path.unlink(missing_ok=True)


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[Robot]:
    """A robot on the thread of stitching sessions."""
    one = Robot(tmp_path / "sessions")
    yield one
    one.end()


@pytest.fixture(scope="module")
def ball() -> Reconstruction:
    """A frame in contact."""
    return calibrated_sensor.step("fast", calibrated_sensor.pressed("ball", 3.0).image)
