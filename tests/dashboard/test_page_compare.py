"""Two sensors beside each other."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select

from tacshade_edge.protocol import messages, wire
from tools.testbed.browser import errors
from tools.testbed.dashboard_process import dashboard
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import wait_until
from tools.testbed.published_sensor import PublishedSensor, bump
from tools.testbed.shown_page import NEEDS_A_BROWSER, js, opened, shows, text, until_shown

pytestmark = NEEDS_A_BROWSER
ROW, COL = 236.0, 300.0


def test_two_hands_are_compared_cell_by_cell_in_the_cells_of_the_first(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "run-a") as first,
        PublishedSensor(broker.port, "run-b") as other,
    ):
        opened(page, address, "run-a")
        wait_until(lambda: len(Select(page.find_element(By.ID, "against")).options) == 3, 15, "there is another")
        Select(page.find_element(By.ID, "against")).select_by_value("run-b")
        shows(page, "compare-words", "it has published nothing yet")
        until_shown(page, first, lambda: bump(7, 2.0, ROW, COL, 4), 7)

        def compared() -> bool:
            other.show(bump(8, 1.5, ROW, COL, 2))  # another profile's cells are smaller
            return js(page, "tacshade.compared") is not None

        wait_until(compared, 15, "both are there")
        seen = js(page, "tacshade.compared")
        assert seen["worst_mm"] == pytest.approx(-0.5, abs=0.01)
        assert (seen["row"], seen["col"]) == (ROW, COL)
        heights = [bump(0, depth_mm, ROW, COL, 4).height.height_mm for depth_mm in (2.0, 1.5)]
        assert seen["mean_mm"] == pytest.approx(np.nanmean(np.abs(heights[1] - heights[0])), rel=0.02)
        shows(page, "compare-words", "-0.500 mm at worst, at row 236, col 300 px")
        shows(page, "compare-numbers", "greatest depth, mm 2.00 1.50 -0.50")
        shows(page, "compare-numbers", "frame 7 8")
        other.tell("state", b"", retain=True)  # gone
        wait_until(lambda: not page.find_element(By.ID, "compare").is_displayed(), 15, "nothing to compare with")
        assert errors(page) == []


def test_numbers_stand_under_their_own_picture_only(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "run-a") as first,
        PublishedSensor(broker.port, "run-b") as other,
    ):
        opened(page, address, "run-a")
        wait_until(lambda: len(Select(page.find_element(By.ID, "against")).options) == 3, 15, "there is another")
        Select(page.find_element(By.ID, "against")).select_by_value("run-b")
        until_shown(page, first, lambda: bump(7, 2.0, ROW, COL, 4), 7)

        def compared() -> bool:
            other.show(bump(7, 1.5, ROW, COL, 4))
            return js(page, "tacshade.compared") is not None

        wait_until(compared, 15, "both are there")
        shows(page, "compare-numbers", "greatest depth, mm 2.00 1.50 -0.50")
        # Pictures without numbers, then numbers without their picture.
        for sensor in (first, other):
            sensor.tell("height", wire.encode_height(bump(8, 1.0, ROW, COL, 4), calibration_crc32=1))
        shows(page, "compare-numbers", "frame 8 8")
        wait_until(lambda: "depth" not in text(page, "compare-numbers"), 15, "no numbers of another picture")
        wait_until(lambda: text(page, "n-depth") == "", 15, "no depth of another picture")
        assert text(page, "objects") == ""
        for sensor in (first, other):
            sensor.tell("contact", messages.encode_contact(bump(9, 3.0, ROW, COL, 4), fps=30.0))
            sensor.tell("contact", messages.encode_contact(bump(8, 1.0, ROW, COL, 4), fps=30.0))
        shows(page, "compare-numbers", "greatest depth, mm 1.00 1.00")
        assert text(page, "n-depth") == "1.00"
        assert errors(page) == []


def test_a_run_that_is_paused_is_asked_for_its_picture_and_its_answer_is_heard(page: Chrome, tmp_path: Path) -> None:
    paused = {"state": "paused", "position_s": 3.0, "length_s": 9.0, "speed": 1, "frame": 91}
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "run-a") as first,
        PublishedSensor(broker.port, "run-b") as other,
        Subscriber(broker.port, "tacshade/run-b/req/replay") as seen,
    ):
        other.tell("status/replay", json.dumps(paused).encode(), retain=True)
        opened(page, address, "run-a")
        wait_until(lambda: len(Select(page.find_element(By.ID, "against")).options) == 3, 15, "there is another")
        until_shown(page, first, lambda: bump(91, 2.0, ROW, COL, 4), 91)
        Select(page.find_element(By.ID, "against")).select_by_value("run-b")
        asked = json.loads(seen.wait_for("tacshade/run-b/req/replay")[0])
        assert asked["seek_s"] == pytest.approx(2.999)
        refusal = {"transaction": asked["transaction"], "ok": False, "error": "the recording is gone"}
        other.tell("res/replay", json.dumps(refusal).encode())
        shows(page, "compare-words", "run-b is paused: the recording is gone")
        assert errors(page) == []
