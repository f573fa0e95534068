"""The camera as it watches: the simulated sensor, and a camera that hangs."""

from __future__ import annotations

import contextlib
import itertools
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.fake_printer import FakePrinter, Faults, Sensor

from tacshade_edge.capture.live import Live, Terminal
from tacshade_edge.capture.page import Page
from tacshade_edge.capture.printer.head import Head, KeypressStop
from tacshade_edge.capture.printer.line import PrinterLine, SafetyStop
from tacshade_edge.capture.printer.touch import ContactDetector, Expected, Touch, descent, search
from tacshade_edge.core.calibration.calibrate import calibrate
from tacshade_edge.core.calibration.inputs import Sensor as Stated
from tacshade_edge.core.calibration.presses.press_check import PressCheck
from tacshade_edge.devices.camera.simulated import SimulatedSource
from tacshade_edge.devices.serial.port import SerialPort
from tacshade_edge.settings.sensor_file import PrinterFile
from tacshade_edge.simulator.truth import SimulatedSensor
from tacshade_edge.storage.tables.pressed_file import PressedFile
from tacshade_edge.types import Frame

LIMITS = PrinterFile(x_mm=[0, 220], y_mm=[0, 220], z_mm=[57, 200], start_mm=[100, 100, 64], feed_mm_s=50)
UPRIGHT = Sensor(x_mm=100, y_mm=100, tip_z_mm=61.23, yaw_deg=0)


@pytest.fixture(scope="module")
def check() -> PressCheck:
    images = [SimulatedSensor().frame((), 900 + k).image for k in range(10)]
    return PressCheck(calibrate(Stated(20, 14, 50, "bright"), images).calibration)


class Camera(SimulatedSource):
    """The simulated one; at some time it may give the same picture for ever, or none that is new."""

    change: Callable[[Frame], Frame] | None = None

    def read(self) -> Frame:
        frame = super().read()
        return frame if self.change is None else self.change(frame)


@contextlib.contextmanager
def touch(folder: Path, check: PressCheck, faults: Faults | None = None) -> Iterator[tuple[Touch, FakePrinter, Camera]]:
    """A ball 2.8 mm above the tip."""
    with contextlib.ExitStack() as stack:
        printer = stack.enter_context(FakePrinter(folder / "hand.csv", sensor=UPRIGHT, faults=faults or Faults()))
        source = Camera(fps=30, script=PressedFile(folder / "hand.csv"))
        source.open()
        page = Page()
        stack.callback(page.close)
        read, _key = os.pipe()
        terminal = Terminal(read, stack.enter_context(open(os.devnull, "w")))
        live, hand, line = (
            Live(source, terminal, page, None, lambda circle: None),
            KeypressStop(terminal),
            PrinterLine(SerialPort(printer.port, 115200, 5.0)),
        )
        stack.callback(line.close)
        stack.enter_context(terminal.keys())
        head = Head(line, LIMITS, hand)
        line.connect()
        head.prepare(home=True)
        head.to_start()
        made = Touch(head, ContactDetector(live, check, hand), LIMITS.z_mm[0])
        made.detector.learn_rest()
        yield made, printer, source


@pytest.mark.slow
def test_a_touch_is_found_within_a_twentieth_of_a_millimetre(tmp_path: Path, check: PressCheck) -> None:
    with touch(tmp_path, check) as (one, printer, _):
        found_mm = one.from_afar()
        assert abs(found_mm - printer.sensor.tip_z_mm) < 0.05
        one.free_over(found_mm)
        assert abs(one.from_near(100, 100, found_mm + 0.4) - found_mm) < 0.05


@pytest.mark.slow
def test_where_the_picture_and_the_place_do_not_agree(tmp_path: Path, check: PressCheck) -> None:
    with touch(tmp_path, check) as (one, printer, _):
        one.detector.learn_free()
        with pytest.raises(
            SafetyStop, match=r"found contact in the picture \+\d.\d\d mm from the expected first touch, expected no"
        ):
            one.down(printer.sensor.tip_z_mm - 2, printer.sensor.tip_z_mm - 3)
        assert one.head.z_mm > printer.sensor.tip_z_mm - 2.0  # one long step at most
        one.lift()
        one.detector.learn_free()
        printer.faults.loses_steps_below_mm = 63.0
        with pytest.raises(
            SafetyStop, match=r"found no contact in the picture -1\.00 mm from the .*, expected contact"
        ):
            one.down(printer.sensor.tip_z_mm, printer.sensor.tip_z_mm - 3)
        one.lift()
        one.detector.learn_free()
        printer.faults.loses_steps_below_mm = 100.0  # and no touch at all above the least height
        printer.press()
        with pytest.raises(SafetyStop, match=r"found no contact down to z 6\d"):
            one.from_near(100, 100, printer.sensor.tip_z_mm + 2.5)


@pytest.mark.slow
def test_a_camera_that_cannot_be_believed(tmp_path: Path, check: PressCheck) -> None:
    with touch(tmp_path, check) as (one, _, camera):
        one.detector.learn_free()
        last = camera.read()
        camera.change = lambda frame: Frame(frame.seq, frame.t_ns, frame.wall_ns, last.image)
        with pytest.raises(SafetyStop, match="keeps delivering the same picture"):
            one.detector.look()
        began_ns = time.monotonic_ns()
        camera.change = lambda frame: Frame(frame.seq, began_ns, frame.wall_ns, frame.image)
        with pytest.raises(SafetyStop, match="fewer than 4 new pictures within 5 s"):
            one.detector.look()
        camera.change = lambda frame: Frame(frame.seq, frame.t_ns, frame.wall_ns, np.roll(frame.image, 25, axis=1))
        with pytest.raises(SafetyStop, match=r"since the references|is unusable"):
            one.detector.look()


HEIGHT = st.floats(-200, 200)


@given(HEIGHT, HEIGHT, st.floats(0, 40))
def test_a_descent_goes_down_to_its_end_and_never_below_it(from_z: float, touch_z: float, lower: float) -> None:
    to_z = from_z - lower
    steps = list(descent(from_z, touch_z, to_z))
    heights = [from_z, *(step.z_mm for step in steps)]
    assert all(before > after for before, after in itertools.pairwise(heights))
    assert heights[-1] == (to_z if lower else from_z)
    for before, step in zip(heights, steps, strict=False):
        short = step.z_mm < touch_z + 1
        assert before - step.z_mm <= (0.5 if short else 2.0) + 1e-9


def test_what_is_seen_must_fit_the_place() -> None:
    expected = {step.z_mm: step.expected for step in descent(14.0, 10.0, 8.5)}
    assert expected == {
        12.0: Expected.FREE,
        11.0: Expected.FREE,
        10.5: Expected.FREE,
        10.0: Expected.ANYTHING,
        9.5: Expected.ANYTHING,
        9.0: Expected.TOUCHED,
        8.5: Expected.TOUCHED,
    }


@given(HEIGHT, HEIGHT, st.floats(0.05, 2))
def test_a_search_ends_above_the_least(from_z: float, least_z: float, step_mm: float) -> None:
    heights = [from_z, *search(from_z, least_z, step_mm)]
    assert all(z >= least_z - 1e-9 for z in heights[1:])
    assert all(0 < before - after <= step_mm + 1e-9 for before, after in itertools.pairwise(heights))
