"""A person who corrects the visible circle by three clicks in a browser, beside the real command."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from support.browser import browser, errors
from support.person import person
from support.shown_page import NEEDS_A_BROWSER, js, shows

from tacshade_edge.settings.sensor_file import read_sensor
from tacshade_edge.simulator.truth import SimulatedSensor
from tacshade_edge.types import Disc
from tools.testbed.patience import wait_until

pytestmark = [*NEEDS_A_BROWSER, pytest.mark.slow]

SENSOR = "skin_radius_mm: 20  # as drawn\nvisible_half_angle_deg: 50\ncamera_distance_mm: 14\npolarity: bright\n"


def click(page: Chrome, row: float, col: float, *, held: bool = False) -> None:
    """On a place of the picture, from its middle; `held`: until the next picture is shown."""
    view = page.find_element(By.ID, "view")
    scale = js(page, "view.getBoundingClientRect().width / picture.naturalWidth")
    rows, cols = js(page, "[picture.naturalHeight, picture.naturalWidth]")
    off = [round((at + 0.5 - size / 2) * scale) for at, size in ((col, cols), (row, rows))]
    at_place = ActionChains(page).move_to_element_with_offset(view, *off)
    if not held:
        at_place.click().perform()
        return
    shown = js(page, "picture.src")
    at_place.click_and_hold().perform()
    wait_until(lambda: js(page, "picture.src") != shown, 10, "another picture")
    ActionChains(page).release().perform()


def rim(disc: Disc, *degrees: float) -> list[tuple[float, float]]:
    angles = np.radians(degrees)
    return [(disc.row_c + disc.radius_px * math.sin(a), disc.col_c + disc.radius_px * math.cos(a)) for a in angles]


def yellow_part(page: Chrome, disc: Disc) -> float:
    """Part of a circle's rim that the picture shows in the circle's colour."""
    seen = cv2.imdecode(np.frombuffer(page.get_screenshot_as_png(), np.uint8), cv2.IMREAD_COLOR).astype(int)
    left, top, scale = js(
        page,
        "(r => [r.left, r.top, r.width / picture.naturalWidth])(view.getBoundingClientRect())",
    )
    is_yellow = (seen[..., 2] - seen[..., 0] > 60) & (seen[..., 1] - seen[..., 0] > 40)
    near = cv2.dilate(is_yellow.astype(np.uint8), np.ones((5, 5), np.uint8))
    rows, cols = np.array(rim(disc, *range(0, 360, 5))).T
    return float(np.mean(near[(top + scale * rows).astype(int), (left + scale * cols).astype(int)]))


def test_three_clicks_state_the_circle_and_a_button_takes_it_back(tmp_path: Path) -> None:
    config, out = tmp_path / "sim.yaml", tmp_path / "mysensor"
    config.write_text("source: {kind: simulated, fps: 10, pressed: hand.csv}\n")
    (tmp_path / "hand.csv").write_text("indenter,radius_mm,depth_mm,x_mm,y_mm\n")
    out.mkdir()
    (out / "SENSOR.yaml").write_text(SENSOR)
    true = SimulatedSensor().model.geometry.disc
    clicked = Disc(true.row_c + 6, true.col_c - 8, true.radius_px - 12)
    with person(str(out), "--config", str(config)) as one, browser(tmp_path / "chromium") as page:
        one.hears("live picture: ")
        one.hears("\n")
        address = one.before.strip()
        one.hears("Enter takes 10 references.")
        one.types("")
        one.hears("press 1 (ball")
        page.get(address)
        wait_until(lambda: yellow_part(page, true) > 0.9, 20, "the circle that is found is drawn")
        assert yellow_part(page, clicked) < 0.5

        for row, col in ((100, 100), (150, 150), (200, 200)):
            click(page, row, col)
        shows(page, "answer", "three points: found ")
        assert (out / "SENSOR.yaml").read_text() == SENSOR

        for row, col in rim(clicked, 80, 200, 320):
            click(page, row, col, held=True)
        shows(page, "answer", "using your three points")
        shows(page, "text", "as clicked (visible_circle in SENSOR.yaml)")
        stated = read_sensor(out / "SENSOR.yaml").visible_circle
        assert stated is not None
        assert (stated.row_c, stated.col_c, stated.radius_px) == pytest.approx(
            (clicked.row_c, clicked.col_c, clicked.radius_px), abs=1.5
        )
        assert (out / "SENSOR.yaml").read_text().startswith(SENSOR)
        wait_until(lambda: yellow_part(page, clicked) > 0.9, 20, "the circle that was clicked is drawn")
        one.types("look")
        one.hears("this folder already has 10 references and 0 presses")  # judged again, with this circle
        one.hears(f"disc {stated.radius_px:.0f} px")

        page.find_element(By.ID, "back").click()
        shows(page, "answer", "using the circle found in the picture again")
        wait_until(lambda: yellow_part(page, true) > 0.9, 20, "the circle that is found is drawn again")
        assert (out / "SENSOR.yaml").read_text() == SENSOR
        assert [told for told in errors(page) if "favicon" not in told and "400" not in told] == []
        one.types("done")
        assert one.ends() == 0


def test_where_no_circle_is_found_three_clicks_state_one(tmp_path: Path) -> None:
    grey = np.random.default_rng(1).integers(120, 124, (480, 640)).astype(np.uint8)
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    first = tmp_path / "first.png"
    cv2.imwrite(str(first), grey)
    for k in range(2000):
        (pictures / f"{k:04d}.png").hardlink_to(first)
    config, out = tmp_path / "files.yaml", tmp_path / "mysensor"
    config.write_text(f"source: {{kind: files, path: {pictures}, fps: 10}}\n")
    out.mkdir()
    (out / "SENSOR.yaml").write_text(SENSOR)
    with person(str(out), "--config", str(config)) as one, browser(tmp_path / "chromium") as page:
        one.hears("live picture: ")
        one.hears("\n")
        page.get(one.before.strip())
        one.hears("Enter takes 10 references.")
        one.types("")
        one.hears("rejected: found no ")
        one.hears("to set the circle, click three points on the dome's rim on the page")
        shows(page, "text", "no disc: ")
        wait_until(lambda: js(page, "picture.naturalWidth") > 0, 10, "a picture")
        wanted = Disc(240.0, 320.0, 150.0)
        for row, col in rim(wanted, 0, 120, 240):
            click(page, row, col)
        wait_until(lambda: yellow_part(page, wanted) > 0.9, 20, "the circle that was clicked is drawn")
        assert read_sensor(out / "SENSOR.yaml").visible_circle is not None
        one.process.terminate()
        one.ends()
