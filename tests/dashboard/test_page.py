"""The page in headless Chromium, against the real broker, daemon and dashboard process.

::

    TACSHADE_SCREENSHOTS=docs/images .venv/bin/python -m pytest tests/dashboard/

also writes the pictures of docs/how-to/dashboard.md.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select

from support.browser import browser, errors
from support.dashboard_process import dashboard
from support.mqtt_rig import Broker
from support.patience import wait_until
from support.published_sensor import (
    COLS,
    DISC,
    PublishedSensor,
    bump,
    dragged,
    uncertain,
)
from support.published_sensor import calibration as calibrated_sensor
from support.shown_page import (
    NEEDS_A_BROWSER,
    daemon,
    drawn,
    js,
    opened,
    picture,
    shows,
    text,
    unfold_health,
    until_shown,
)
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.profiles import PROFILES
from tacshade_edge.types import Slip
from tacshade_edge.wire import codec, messages
from tacshade_edge.wire.sensor_topics import ContactEvent

pytestmark = NEEDS_A_BROWSER

TOUCHED_IN_TIME = """document.getElementById("n-contact").value.includes("object")
  && !document.getElementById("n-fps").dataset.level"""


def test_every_cell_has_the_colour_of_its_depth(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    """A known shape: where it lies, how it falls off, what is outside,
    and what the pointer reads.
    """
    row, col = DISC.row_c + 40, DISC.col_c - 60
    opened(page, address)
    until_shown(page, sensor, lambda: uncertain(bump(7, 2.6, row, col), 0.125), 7)
    truth = bump(7, 2.6, row, col).height.height_mm
    scale = js(page, "tacshade.scale_mm")
    assert scale == 3
    for r, c in [(row, col), (row + 50, col), (row, col + 90), (DISC.row_c - 180, DISC.col_c)]:
        shown = js(page, f"tacshade.depthAt({r}, {c})")
        assert shown == pytest.approx(float(truth[round(r), round(c)]), abs=scale / 255), (r, c)
    assert (
        js(page, f"tacshade.depthAt({DISC.row_c}, {DISC.col_c + DISC.radius_px + 1})") is None
    )  # NaN
    assert js(page, f"tacshade.depthAt(1, {COLS - 1})") is None

    canvas = page.find_element(By.ID, "cells")
    to_screen = canvas.rect["width"] / (2 * DISC.radius_px)
    ActionChains(page).move_to_element_with_offset(
        canvas, round(-60 * to_screen), round(40 * to_screen)
    ).perform()
    shows(page, "cursor", "2.6")
    shows(page, "cursor", "± 0.13 mm")
    shows(page, "cursor", "x -")
    shows(page, "n-depth", "2.60")
    shows(page, "objects", "object 1")
    assert text(page, "free") == ""

    Select(page.find_element(By.ID, "range")).select_by_value("10")
    assert js(page, "tacshade.scale_mm") == 10
    assert js(page, f"tacshade.depthAt({row}, {col})") == pytest.approx(2.6, abs=10 / 255)
    shows(page, "ticks", "10 mm")
    Select(page.find_element(By.ID, "range")).select_by_value("auto")

    until_shown(page, sensor, lambda: bump(8, 0.0, row, col), 8)  # released
    assert js(page, "tacshade.drawnPeak()") == 0
    assert text(page, "free") == "nothing touches"
    assert text(page, "objects") == ""


def test_arrows_show_how_the_skin_was_dragged_and_dots_when_it_slides(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    row, col = DISC.row_c + 10, DISC.col_c - 20
    opened(page, address)
    until_shown(page, sensor, lambda: dragged(bump(7, 2.6, row, col, 4), 2.0, -1.0), 7)
    wait_until(lambda: js(page, "tacshade.arrows") > 0, 15, "arrows")
    path = js(page, "document.getElementById('arrows').getAttribute('d')")
    shafts = [tuple(map(float, shaft)) for shaft in re.findall(r"M(\S+) (\S+)L(\S+) (\S+)M", path)]
    assert len(shafts) == js(page, "tacshade.arrows") < 200
    longest = max(shafts, key=lambda s: math.hypot(s[2] - s[0], s[3] - s[1]))
    mm_per_px = calibrated_sensor().geometry.mm_per_px
    assert (longest[2] - longest[0]) * mm_per_px == pytest.approx(2.0, abs=0.1)
    assert (longest[3] - longest[1]) * mm_per_px == pytest.approx(-1.0, abs=0.1)
    assert math.hypot(longest[2] - col, longest[3] - row) < 25
    picture(page, "arrows", (1280, 900))
    until_shown(page, sensor, lambda: dragged(bump(8, 2.6, row, col, 4), 2.0, -1.0, Slip.FULL), 8)
    wait_until(lambda: js(page, "tacshade.slips") > 0, 15, "a slip in the chart")
    until_shown(page, sensor, lambda: bump(9, 0.0, row, col, 4), 9)
    assert js(page, "tacshade.arrows") == 0


def test_profile_and_zero_are_changed_through_requests(
    page: Chrome, tmp_path: Path, calibration: Path
) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        daemon(tmp_path, calibration, broker.port),
    ):
        opened(page, address)
        profile = Select(page.find_element(By.ID, "profile"))
        wait_until(
            lambda: page.find_element(By.ID, "profile").is_enabled(), 15, "the sensor is online"
        )
        assert [option.text for option in profile.options] == [
            name for name in PROFILES if name != "paper"
        ]
        profile.select_by_value("accurate")
        shows(page, "answer", "The profile is accurate.")
        wait_until(lambda: page.find_element(By.ID, "profile").is_enabled(), 15, "the answer")
        Select(page.find_element(By.ID, "profile")).select_by_value("fast")
        shows(page, "answer", "The profile is fast.")

        page.find_element(By.ID, "rezero").click()
        shows(page, "answer", "Took a new zero", 30)
        drawn(page)
        picture(page, "dashboard", (1000, 1500), ready=lambda: js(page, TOUCHED_IN_TIME))
        wait_until(lambda: page.find_element(By.ID, "lived").is_displayed(), 15, "a contact")
        unfold_health(page)
        shows(page, "tables", "messages that the page could not read 0")
        wait_until(
            lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "it may be asked again"
        )


def test_a_hand_that_is_not_calibrated_yet_shows_its_picture_and_why(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    missing = Reason(ReasonCode.NOT_CALIBRATED, "not calibrated: found no file")
    picture = cv2.imencode(".jpg", np.full((240, 320), 90, np.uint8))[1].tobytes()
    opened(page, address)
    wait_until(lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "the sensor is online")
    sensor.publish_info("fast", profiles=("fast",), missing=missing)
    sensor.publish("state", b"degraded", retain=True)
    sensor.publish("status/camera", messages.encode_status("unusable", missing), retain=True)
    sensor.publish("health", codec.encode_json({"invalid_reason": missing.text}))
    sensor.publish("preview", picture)
    shows(page, "state", "degraded camera: not calibrated: found no file")
    wait_until(lambda: page.find_element(By.ID, "picture").is_displayed(), 15, "the picture")
    assert not any(
        page.find_element(By.ID, name).is_displayed() for name in ("height", "space", "numbers")
    )
    assert not page.find_element(By.ID, "rezero").is_enabled()
    sensor.publish_info("fast", profiles=("fast",))
    wait_until(lambda: page.find_element(By.ID, "height").is_displayed(), 15, "calibrated")


def test_several_hands(page: Chrome, tmp_path: Path) -> None:
    def tabs() -> list[str]:
        # in one step: the page replaces the tabs when a sensor reports its state
        return list(
            js(
                page,
                (
                    "[...document.querySelectorAll('#sensors button')].map(tab => "
                    "tab.innerText.trim())"
                ),
            )
        )

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "thumb") as thumb,
        PublishedSensor(broker.port, "index") as index,
    ):
        opened(page, address, "thumb")
        wait_until(lambda: tabs() == ["index", "thumb"], 10, "both tabs")
        until_shown(page, thumb, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        index.show(bump(99, 0.9, 200, 300, step_px=4))
        thumb.show(bump(2, 1.0, 200, 300, step_px=4))
        wait_until(lambda: js(page, "tacshade.seq === 2"), 10, "only the chosen sensor's")
        page.find_elements(By.CSS_SELECTOR, "#sensors button")[0].click()
        assert js(page, "[tacshade.sensor, tacshade.seq]") == ["index", None]
        until_shown(page, index, lambda: bump(100, 0.9, 200, 300, step_px=4), 100)
        assert js(page, "tacshade.drawnPeak()") == pytest.approx(0.9, abs=0.01)
        assert page.current_url.endswith("#index")
        assert page.title.startswith("index")
        index.publish("state", b"offline", retain=True)
        shows(page, "state", "offline")
        assert (
            js(page, "tacshade.sensor") == "index"
        )  # the page does not jump away from what one looks at


def boxes(page: Chrome, selector: str) -> list[list[float]]:
    """Left, top, right and bottom of each on the screen."""
    found: list[list[float]] = js(
        page,
        f"[...document.querySelectorAll('{selector}')].map((e) => e.getBoundingClientRect())"
        ".map((b) => [b.left, b.top, b.right, b.bottom])",
    )
    return found


def test_a_phone_shows_what_matters_on_one_screen(tmp_path: Path) -> None:
    width, height = 390, 844
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "left-index") as sensor,
        browser(tmp_path / "chromium") as page,
    ):
        device = {"width": width, "height": height, "deviceScaleFactor": 2, "mobile": True}
        page.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", device)
        page.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
        opened(page, address)
        touching = dragged(bump(1, 2.4, DISC.row_c, DISC.col_c, 4), 1.0, 0.0)
        until_shown(page, sensor, lambda: touching, 1)
        shows(page, "n-slip", "sticks")
        for name in ("state", "n-contact", "n-depth", "n-slip", "cells", "bar", "ticks", "cursor"):
            ((left, top, right, bottom),) = boxes(page, f"#{name}")
            assert 0 <= left < right <= width, name
            assert 0 <= top < bottom <= height, name
        assert boxes(page, "#cells")[0][2] - boxes(page, "#cells")[0][0] > 300
        ended = ContactEvent(type="end", id=1, t_ns=2, start_ns=1, end_ns=2, slip=1, objects=1)
        sensor.publish("event/contact", codec.encode_json(ended))
        wait_until(lambda: page.find_element(By.ID, "lived").is_displayed(), 15, "a contact")
        page.execute_script("document.getElementById('lived').open = true")
        assert js(page, "document.documentElement.scrollWidth") <= width
        least = js(
            page,
            "Math.min(...[...document.querySelectorAll('main button, main select')]"
            ".filter((e) => e.checkVisibility()).map((e) => e.getBoundingClientRect().height))",
        )
        assert least >= 40, "a finger needs this much"

        def fresh() -> bool:
            sensor.show(touching)
            return not page.find_element(By.ID, "stale").is_displayed()

        picture(page, "dashboard-phone", ready=fresh)
        assert errors(page) == []


ROW, COL = 236.0, 300.0


def test_two_hands_are_compared_cell_by_cell_in_the_cells_of_the_first(
    page: Chrome, tmp_path: Path
) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "run-a") as first,
        PublishedSensor(broker.port, "run-b") as other,
    ):
        opened(page, address, "run-a")
        wait_until(
            lambda: len(Select(page.find_element(By.ID, "against")).options) == 3,
            15,
            "there is another",
        )
        Select(page.find_element(By.ID, "against")).select_by_value("run-b")
        shows(page, "compare-words", "it has published nothing yet")
        until_shown(page, first, lambda: bump(7, 2.0, ROW, COL, 4), 7)

        def compared() -> bool:
            other.show(bump(8, 1.5, ROW, COL, 2))  # another profile's cells are smaller
            return js(page, "tacshade.compared") is not None

        wait_until(compared, 15, "both are there")
        seen = js(page, "tacshade.compared")
        assert seen["worst_mm"] == pytest.approx(0.5, abs=0.01)  # the first is deeper
        assert (seen["row"], seen["col"]) == (ROW, COL)
        heights = [bump(0, depth_mm, ROW, COL, 4).height.height_mm for depth_mm in (2.0, 1.5)]
        assert seen["mean_mm"] == pytest.approx(
            np.nanmean(np.abs(heights[1] - heights[0])), rel=0.02
        )
        shows(page, "compare-words", "+0.500 mm at worst, at row 236, col 300 px")
        shows(page, "compare-numbers", "greatest depth, mm 2.00 1.50 +0.50")
        shows(page, "compare-numbers", "frame 7 8")
        other.publish("state", b"", retain=True)  # gone
        wait_until(
            lambda: not page.find_element(By.ID, "compare").is_displayed(),
            15,
            "nothing to compare with",
        )
        assert errors(page) == []
