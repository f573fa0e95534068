"""Two sensors beside each other."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select
from support.browser import errors
from support.dashboard_process import dashboard
from support.published_sensor import DISC, PublishedSensor, bump
from support.shown_page import NEEDS_A_BROWSER, js, opened, shows, text, until_shown

from tacshade_edge.protocol import messages, wire
from tools.testbed.mqtt_rig import Broker, Subscriber
from tools.testbed.patience import wait_until

pytestmark = NEEDS_A_BROWSER
ROW, COL = 236.0, 300.0


@contextmanager
def compared_with(page: Chrome, tmp_path: Path) -> Iterator[tuple[PublishedSensor, PublishedSensor]]:
    """A page of run-a that compares it with run-b; neither has published a picture."""
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "run-a") as first,
        PublishedSensor(broker.port, "run-b") as other,
    ):
        opened(page, address, "run-a")
        wait_until(lambda: len(Select(page.find_element(By.ID, "against")).options) == 3, 15, "there is another")
        Select(page.find_element(By.ID, "against")).select_by_value("run-b")
        yield first, other


def test_two_hands_are_compared_cell_by_cell_in_the_cells_of_the_first(page: Chrome, tmp_path: Path) -> None:
    with compared_with(page, tmp_path) as (first, other):
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
        other.publish("state", b"", retain=True)  # gone
        wait_until(lambda: not page.find_element(By.ID, "compare").is_displayed(), 15, "nothing to compare with")
        assert errors(page) == []


def test_numbers_stand_under_their_own_picture_only(page: Chrome, tmp_path: Path) -> None:
    with compared_with(page, tmp_path) as (first, other):
        until_shown(page, first, lambda: bump(7, 2.0, ROW, COL, 4), 7)

        def compared() -> bool:
            other.show(bump(7, 1.5, ROW, COL, 4))
            return js(page, "tacshade.compared") is not None

        wait_until(compared, 15, "both are there")
        shows(page, "compare-numbers", "greatest depth, mm 2.00 1.50 -0.50")
        # Pictures without numbers, then numbers without their picture.
        for sensor in (first, other):
            sensor.publish("height", wire.encode_height(bump(8, 1.0, ROW, COL, 4), calibration_crc32=1))
        shows(page, "compare-numbers", "frame 8 8")
        wait_until(lambda: "depth" not in text(page, "compare-numbers"), 15, "no numbers of another picture")
        wait_until(lambda: text(page, "n-depth") == "", 15, "no depth of another picture")
        assert text(page, "objects") == ""
        for sensor in (first, other):
            sensor.publish("contact", messages.encode_contact(bump(9, 3.0, ROW, COL, 4), fps=30.0))
            sensor.publish("contact", messages.encode_contact(bump(8, 1.0, ROW, COL, 4), fps=30.0))
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
        other.publish("status/replay", json.dumps(paused).encode(), retain=True)
        opened(page, address, "run-a")
        wait_until(lambda: len(Select(page.find_element(By.ID, "against")).options) == 3, 15, "there is another")
        until_shown(page, first, lambda: bump(91, 2.0, ROW, COL, 4), 91)
        Select(page.find_element(By.ID, "against")).select_by_value("run-b")
        asked = json.loads(seen.wait_for("tacshade/run-b/req/replay")[0])
        assert asked["seek_s"] == pytest.approx(2.999)
        refusal = {"transaction": asked["transaction"], "ok": False, "error": "the recording is gone"}
        other.publish("res/replay", json.dumps(refusal).encode())
        shows(page, "compare-words", "run-b is paused: the recording is gone")
        assert errors(page) == []


def test_both_pictures_have_one_scale_which_holds_the_deeper_one(page: Chrome, tmp_path: Path) -> None:
    def drawn_mm(name: str, scale_mm: float) -> float:
        """What the colour of this picture's deepest cell says on a scale."""
        cell = [int(at // 4 - (centre - DISC.radius_px) // 4) for at, centre in ((COL, DISC.col_c), (ROW, DISC.row_c))]
        read = (
            "const [name, x, y, scale_mm, done] = arguments;"
            "const copy = new OffscreenCanvas(1, 1).getContext('2d', { willReadFrequently: true });"
            "copy.drawImage(document.getElementById(`${name}-cells`), x, y, 1, 1, 0, 0, 1, 1);"
            "const at = copy.getImageData(0, 0, 1, 1).data;"
            "import('./colours.js').then(({ depthOf }) => done(depthOf(at[0], at[1], at[2], scale_mm)));"
        )
        return float(page.execute_async_script(read, name, *cell, scale_mm))

    def ends_at(ticks: str) -> bool:
        return text(page, "compare-ticks").replace("\n", " ").endswith(ticks)

    with compared_with(page, tmp_path) as (first, other):
        until_shown(page, first, lambda: bump(7, 1.0, ROW, COL, 4), 7)

        def compared() -> bool:
            other.show(bump(8, 3.6, ROW, COL, 4))
            return js(page, "tacshade.compared") is not None

        wait_until(compared, 15, "both are there")
        assert ends_at(" 4 mm")
        assert drawn_mm("first", 4.0) == pytest.approx(1.0, abs=0.01)
        assert drawn_mm("other", 4.0) == pytest.approx(3.6, abs=0.01)
        assert js(page, "tacshade.scale_mm") == 1.0  # the map above shows the first alone
        Select(page.find_element(By.ID, "range")).select_by_value("2")  # a person's choice, though one is deeper
        wait_until(lambda: ends_at(" 2 mm"), 15, "the chosen scale")
        assert drawn_mm("first", 2.0) == pytest.approx(1.0, abs=0.01)
        assert drawn_mm("other", 2.0) == 2.0
        Select(page.find_element(By.ID, "range")).select_by_value("auto")
        wait_until(lambda: ends_at(" 4 mm"), 15, "both again")
        assert errors(page) == []


def test_this_moment_is_held_and_compared_with_what_comes_after(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "run-a") as sensor,
    ):
        opened(page, address, "run-a")
        against = Select(page.find_element(By.ID, "against"))
        wait_until(lambda: len(against.options) == 2, 15, "only the moment can be compared with")
        against.select_by_visible_text("this moment")  # nothing is on the screen that could be held
        assert not page.find_element(By.ID, "compare").is_displayed()
        assert against.first_selected_option.text == "nothing"
        until_shown(page, sensor, lambda: bump(7, 2.0, ROW, COL, 4), 7)
        wait_until(lambda: text(page, "n-depth") == "2.00", 15, "the numbers of the moment")
        against.select_by_visible_text("this moment")
        shows(page, "compare-words", "0.000 mm at worst")
        until_shown(page, sensor, lambda: bump(8, 1.5, ROW, COL, 4), 8)
        shows(page, "compare-words", "+0.500 mm at worst, at row 236, col 300 px")
        shows(page, "compare-numbers", "run-a then more")
        shows(page, "compare-numbers", "frame 8 7")
        shows(page, "compare-numbers", "greatest depth, mm 1.50 2.00 +0.50")
        assert text(page, "other-name").startswith("run-a, ")
        assert text(page, "difference-name").endswith(" less run-a")
        assert against.first_selected_option.text == "this moment"
        against.select_by_visible_text("nothing")
        assert not page.find_element(By.ID, "compare").is_displayed()
        assert js(page, "tacshade.compared") is None
        assert errors(page) == []
