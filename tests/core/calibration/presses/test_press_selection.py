from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from support.calibrated_sensor import HALF, TACTIP, presses, references, sensor_of, unloaded

from tacshade_edge.core.calibration.calibrate import CalibrationResult, calibrate
from tacshade_edge.core.calibration.inputs import KnownPress
from tacshade_edge.core.calibration.presses.press_selection import MIN_PRESSES
from tacshade_edge.errors import ConfigError
from tacshade_edge.inference.network import load_networks
from tacshade_edge.simulator import camera_faults
from tacshade_edge.simulator.model import SensorModel
from tacshade_edge.simulator.script import ball_presses
from tacshade_edge.types import U8, Polarity
from tools.testbed.simulator.families import sensor_name

pytestmark = pytest.mark.slow


def fitted(table: tuple[KnownPress, ...] | list[KnownPress]) -> CalibrationResult:
    return calibrate(sensor_of(HALF), references(), table)


def shifted(image: U8, px: int) -> U8:
    return camera_faults.shift(image, 0, px)


def test_too_few_presses() -> None:
    with pytest.raises(ConfigError, match=f"found 7 presses, expected at least {MIN_PRESSES}"):
        fitted(presses()[:7])


@pytest.mark.parametrize("depths_mm", [(0.0, -1.0, 20.0), (1e9, float("nan"), float("inf"))])
def test_presses_that_cannot_be_are_all_named_and_the_others_used(depths_mm: tuple[float, ...]) -> None:
    first, second, *rest = presses()
    bad = [replace(first, name=f"bad {k}", depth_mm=depth_mm) for k, depth_mm in enumerate(depths_mm)]
    small = replace(second, name="small", image=second.image[:-2])
    black = replace(second, name="black", image=second.image * 0)
    flat = replace(second, name="flat", radius_mm=0.0)
    result = fitted([*bad, small, *rest])
    assert [line.partition(":")[0] for line in result.warnings] == ["bad 0", "bad 1", "bad 2", "small"]
    assert all(line.endswith("; left out") for line in result.warnings)
    assert result.calibration.fit is not None
    assert result.calibration.fit.presses == 18
    with pytest.raises(ConfigError, match=r"^6 of 14 presses are unusable; the first one: bad 0: ") as refused:
        fitted([*bad, small, black, flat, *rest[:8]])
    assert [line.partition(":")[0] for line in refused.value.others] == ["bad 1", "bad 2", "small", "black", "flat"]


def test_a_press_that_disagrees_is_named_and_left_out() -> None:
    wrong = replace(presses()[6], depth_mm=presses()[6].depth_mm + 2.5)
    result = fitted([*presses()[:6], wrong, *presses()[7:]])
    (warning,) = result.warnings
    assert warning.startswith(f"press 6: found a depth of {wrong.depth_mm:.2f} mm, expected ")
    assert warning.endswith("; left out")
    assert result.calibration.fit is not None
    assert result.calibration.fit.presses == 19


def test_too_many_that_disagree_are_refused() -> None:
    far = [replace(p, x_mm=(p.x_mm or 0) + (6 if k % 2 else -6)) if k % 3 else p for k, p in enumerate(presses())]
    with pytest.raises(ConfigError, match=r"of 20 presses are unusable; the first one: press \d+: found x "):
        fitted(far)


ACCURATE = {"accurate": load_networks()["accurate"]}
Change = Callable[[KnownPress], KnownPress]
GROSS: dict[str, tuple[Change, str]] = {
    "cm": (lambda p: replace(p, depth_mm=p.depth_mm / 10), r"PRESSES.csv: depth_mm: .* are the depths in cm\?"),
    "in": (lambda p: replace(p, depth_mm=p.depth_mm / 25.4), r"depth_mm: .* are the depths in inches\?"),
    "m": (lambda p: replace(p, depth_mm=p.depth_mm / 1000), r"depth_mm: .* 1?\d\d\d times as deep .* in m\?"),
    "all in m": (
        lambda p: replace(p, depth_mm=p.depth_mm / 1000, x_mm=(p.x_mm or 0) / 1000, y_mm=(p.y_mm or 0) / 1000),
        r"are the depths in m\?.*; PRESSES.csv: x_mm, y_mm: .* if x and y are in m",
    ),
    "diameters": (lambda p: replace(p, radius_mm=2 * p.radius_mm), r"radius_mm: .* 0\.[56] times .* diameters\?"),
    "halved": (lambda p: replace(p, radius_mm=p.radius_mm / 2), r"radius_mm: .* times .* halved\?"),
    "swapped": (lambda p: replace(p, x_mm=p.y_mm, y_mm=p.x_mm), r"x_mm, y_mm: .* if x and y are swapped"),
    "-x": (lambda p: replace(p, x_mm=-(p.x_mm or 0)), r"x_mm, y_mm: .* if x has the opposite sign"),
    "-y": (lambda p: replace(p, y_mm=-(p.y_mm or 0)), r"x_mm, y_mm: .* if y has the opposite sign"),
}


@pytest.mark.parametrize("mistake", GROSS)
def test_a_gross_mistake_of_the_table_is_named(mistake: str) -> None:
    change, said = GROSS[mistake]
    with pytest.raises(ConfigError, match=said) as refusal:
        calibrate(sensor_of(HALF), references(), [change(p) for p in presses()], networks=ACCURATE)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("placed", [True, False])
@pytest.mark.parametrize(("factor", "said"), [(2.0, "a diameter"), (0.5, "half of the radius")])
def test_a_skin_radius_off_by_two_is_named(factor: float, said: str, placed: bool) -> None:
    table = presses() if placed else [replace(p, x_mm=None, y_mm=None) for p in presses()]
    wrong = replace(sensor_of(HALF), skin_radius_mm=factor * HALF.skin_radius_mm)
    with pytest.raises(ConfigError, match=rf"SENSOR.yaml: skin_radius_mm: found \S+, .* is it {said}\? expected about"):
        calibrate(wrong, references(), table, networks=ACCURATE)


@pytest.mark.parametrize(("model", "found", "expected"), [(HALF, "dark", "bright"), (TACTIP, "bright", "dark")])
def test_a_wrong_polarity_is_named(model: SensorModel, found: Polarity, expected: str) -> None:
    with pytest.raises(ConfigError, match=f"SENSOR.yaml: polarity: found {found}, expected {expected}: the places"):
        calibrate(replace(sensor_of(model), polarity=found), references(model), presses(model))


@pytest.mark.parametrize("name", ["5", "other:31"])  # the markers of the last look like a TacTip's pins
def test_an_unstated_polarity_is_found(name: str) -> None:
    model = sensor_name(name).make().model
    unstated = replace(sensor_of(model), polarity=None)
    found = calibrate(unstated, *_frames(name)).calibration
    assert found.polarity == sensor_of(model).polarity


@pytest.mark.parametrize(("model", "wrong", "likely"), [(HALF, "dark", "bright"), (TACTIP, "bright", "dark")])
def test_a_reference_contradicts_a_wrong_polarity(model: SensorModel, wrong: Polarity, likely: str) -> None:
    (warning,) = calibrate(replace(sensor_of(model), polarity=wrong), references(model)).warnings
    assert warning.startswith(f"polarity: found {wrong}, expected {likely}: the reference shows")


@pytest.mark.parametrize("name", ["3", "5", "7", "other:4", "other:31", "square:5", "capped:3"])
def test_no_reference_of_another_print_shows_white_pins(name: str) -> None:
    model = sensor_name(name).make().model
    unstated = replace(sensor_of(model), polarity=None, visible_circle=model.geometry.disc)
    image = sensor_name(name).make().frame((), 0).image
    assert calibrate(unstated, [image]).calibration.polarity == "bright"


def test_without_presses_the_polarity_is_a_guess() -> None:
    found = calibrate(replace(sensor_of(TACTIP), polarity=None), references(TACTIP))
    assert found.calibration.polarity == "dark"
    assert found.warnings == (
        "polarity: assumed dark; only presses at stated places show it, and only `paper` uses it",
    )


def _frames(name: str) -> tuple[list[U8], list[KnownPress]]:
    sensor = sensor_name(name).make()
    free = [sensor.frame((), k).image for k in range(3)]
    return free, [
        KnownPress(f"press {k}", sensor.frame((p,), 100 + k).image, radius_mm, p.depth_mm, p.x_mm, p.y_mm)
        for k, (p, radius_mm) in enumerate(ball_presses(sensor.model, 14, 3))
    ]


def test_a_true_table_is_not_refused() -> None:
    assert calibrate(sensor_of(HALF), references(), presses(), networks=ACCURATE).warnings == ()
    without_places = [replace(p, x_mm=None, y_mm=None) for p in presses()]
    assert calibrate(sensor_of(HALF), references(), without_places, networks=ACCURATE).calibration.factors
    assert calibrate(sensor_of(TACTIP), references(TACTIP), presses(TACTIP)).calibration.fit is not None


@pytest.mark.parametrize("name", ["5", "21", "other:31"])
def test_true_tables_of_other_sensors_are_not_refused(name: str) -> None:
    """And diameters are, on each."""
    sensor, (free, table) = sensor_name(name).make(), _frames(name)
    assert calibrate(sensor_of(sensor.model), free, table, networks=ACCURATE).calibration.factors
    doubled = [replace(p, radius_mm=2 * p.radius_mm) for p in table]
    with pytest.raises(ConfigError, match=r"are they diameters\?"):
        calibrate(sensor_of(sensor.model), free, doubled, networks=ACCURATE)


def test_a_wrong_unit_is_named_without_a_network() -> None:
    with pytest.raises(ConfigError, match=r"are the depths in cm\?"):
        fitted([replace(press, depth_mm=press.depth_mm / 10) for press in presses()])


def test_a_camera_that_moved_at_a_press_or_for_all_of_them() -> None:
    one = [replace(presses()[0], image=shifted(presses()[0].image, 1)), *presses()[1:]]
    assert fitted(one).warnings == ("press 0: the image moved by 1.0 px since the references were taken",)
    far = [replace(presses()[0], image=shifted(presses()[0].image, 5)), *presses()[1:]]
    (warning,) = fitted(far).warnings
    assert warning.startswith("press 0: the camera has moved by 4.9 px")
    assert warning.endswith("since the reference was taken; left out")
    with pytest.raises(
        ConfigError, match="20 of 20 presses are unusable; the first one: press 0: the camera has moved"
    ):
        fitted([replace(press, image=shifted(press.image, 5)) for press in presses()])


def test_other_light_at_a_press_is_a_warning() -> None:
    dim = [replace(presses()[0], image=camera_faults.gain(presses()[0].image, 0.7)), *presses()[1:]]
    (warning,) = fitted(dim).warnings
    assert warning.startswith("press 0: 0.7")
    assert warning.endswith("times the light since the references were taken")


def test_presses_that_show_no_contact_are_refused() -> None:
    with pytest.raises(ConfigError, match="no contact"):
        fitted([replace(press, image=unloaded(noise_seed=60 + k)) for k, press in enumerate(presses())])


def test_one_ball_of_another_radius_is_named_and_left_out() -> None:
    deep = max(range(20), key=lambda k: presses()[k].depth_mm)
    doubled = replace(presses()[deep], radius_mm=2 * presses()[deep].radius_mm)
    table = [doubled if k == deep else press for k, press in enumerate(presses())]
    (warning,) = calibrate(sensor_of(HALF), references(), table, networks=ACCURATE).warnings
    assert warning.startswith(f"press {deep}: found a ball of {doubled.radius_mm:g} mm, expected about ")
    assert warning.endswith("its diameter?; left out")


def test_one_press_with_x_and_y_swapped_is_named_and_left_out() -> None:
    apart = max(range(20), key=lambda k: abs((presses()[k].x_mm or 0) - (presses()[k].y_mm or 0)))
    press = presses()[apart]
    table = [replace(p, x_mm=p.y_mm, y_mm=p.x_mm) if p is press else p for p in presses()]
    (warning,) = calibrate(sensor_of(HALF), references(), table, networks=ACCURATE).warnings
    assert warning.startswith(f"press {apart}: found x {press.y_mm:.1f}, y {press.x_mm:.1f} mm, expected ")


@pytest.mark.parametrize(("name", "pitch_mm"), [("61", 1.27), ("other:53", 1.32)])
def test_a_fine_lattice_keeps_its_right_presses(name: str, pitch_mm: float) -> None:
    """Where the skin brightens most is elsewhere then."""
    sensor = sensor_name(name).make()
    sensor = type(sensor)(replace(sensor.model, pitch_mm=pitch_mm))  # type: ignore[call-arg]
    free = [sensor.frame((), 1000 + k).image for k in range(5)]
    table = [
        KnownPress(f"press {k}", sensor.frame((p,), 2000 + k).image, radius_mm, p.depth_mm, p.x_mm, p.y_mm)
        for k, (p, radius_mm) in enumerate(ball_presses(sensor.model, 40, int(name.rpartition(":")[2])))
    ]
    result = calibrate(sensor_of(sensor.model), free, table, networks=ACCURATE)
    assert len(result.presses) == 40
