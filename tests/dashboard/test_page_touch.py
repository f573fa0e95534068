"""The touch panel: numbers with their intervals, what is not known, and nothing asked for while it is not seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from support.dashboard_process import dashboard
from support.published_sensor import DISC, PublishedSensor, bump
from support.shown_page import NEEDS_A_BROWSER, js, opened, picture, shows, text, until_shown

from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Reconstruction, Touch
from tools.testbed.mqtt_rig import Broker
from tools.testbed.patience import wait_until

pytestmark = NEEDS_A_BROWSER

ROWS = """[...document.querySelectorAll("#touch-numbers > div")].map((row) => ({
  name: row.querySelector("dt").textContent, value: row.querySelector("dd").textContent, title: row.title,
  bar: row.querySelector("i").hidden ? null : ["left", "width"].map((end) => row.querySelector("i").style[end])}))"""
KNOWN = Touch(
    {"depth_mm": 1.5, "tilt_x_deg": -8.0, "force_z_n": 2.5}, {"depth_mm": 0.25, "tilt_x_deg": 1.0, "force_z_n": 0.5}
)
OUTSIDE = Touch(
    {"depth_mm": 1.5, "tilt_x_deg": -8.0, "force_z_n": None},
    {"depth_mm": 0.25, "tilt_x_deg": 1.0, "force_z_n": None},
    Reason(ReasonCode.TOUCH_RANGE, "outside the labelled range: force_z_n"),
)


def touched(seq: int, touch: Touch | None) -> Reconstruction:
    return replace(bump(seq, 1.5 if touch else 0.0, DISC.row_c, DISC.col_c, 4), touch=touch)


def percent(bar: list[str]) -> list[float]:
    return [float(part.removesuffix("%")) for part in bar]


def test_numbers_have_their_intervals_and_what_is_not_known_says_why(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
    ):
        opened(page, address)
        assert not page.find_element(By.ID, "touch").is_displayed()
        page.execute_script("document.getElementById('touch').scrollIntoView()")
        until_shown(page, sensor, lambda: touched(7, KNOWN), 7)
        wait_until(lambda: sensor.show(touched(7, KNOWN)) or len(rows(page)) == 3, 15, "the touch")
        depth, tilt, force = rows(page)
        assert [row["name"] for row in (depth, tilt, force)] == ["depth", "tilt x", "force z"]
        assert [row["value"] for row in (depth, tilt, force)] == ["1.50 ± 0.25 mm", "-8.0 ± 1.0 °", "2.50 ± 0.50 N"]
        assert depth["title"] == "One standard deviation; the bar is from −2 to 2 mm"
        assert percent(depth["bar"]) == pytest.approx([50 + 50 * 1.25 / 2, 100 * 0.25 / 2])
        assert percent(tilt["bar"]) == pytest.approx([50 - 50 * 9 / 10, 100 / 10])
        assert text(page, "touch-words") == ""
        picture(page, "touch", (1000, 900), top="touch")

        until_shown(page, sensor, lambda: touched(8, OUTSIDE), 8)
        shows(page, "touch-words", "outside the labelled range: force_z_n")
        *_, force = rows(page)
        assert (force["value"], force["title"], force["bar"]) == (
            "not known",
            "outside the labelled range: force_z_n",
            None,
        )

        before = js(page, "tacshade.undecodable")
        sensor.publish("touch", b'{"seq":9,"touch":{"depth_mm":"deep"},"touch_sigma":{"depth_mm":1}}')
        wait_until(lambda: js(page, "tacshade.undecodable") == before + 1, 15, "it is counted")

        odd = Touch({"a_constructor": 0.5}, {"a_constructor": 0.1})
        until_shown(page, sensor, lambda: touched(9, odd), 9)
        wait_until(lambda: len(rows(page)) == 1, 15, "one number")
        assert (rows(page)[0]["name"], rows(page)[0]["value"]) == ("a constructor", "0.50 ± 0.10 ")

        until_shown(page, sensor, lambda: touched(10, None), 10)
        shows(page, "touch-words", "nothing touches")
        assert not page.find_element(By.ID, "touch-numbers").is_displayed()


def test_it_is_asked_for_while_it_is_seen(page: Chrome, tmp_path: Path) -> None:
    size = page.get_window_size()
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
    ):
        try:
            page.set_window_size(1000, 400)  # it lies below
            opened(page, address)
            for seq in range(3):
                until_shown(page, sensor, lambda seq=seq: touched(seq, KNOWN), seq)
            assert rows(page) == []
            page.execute_script("document.getElementById('touch').scrollIntoView()")
            wait_until(lambda: sensor.show(touched(3, KNOWN)) or len(rows(page)) == 3, 15, "the touch")
            page.execute_script("scrollTo(0, 0)")
            wait_until(
                lambda: (
                    sensor.show(touched(next(SEQS), KNOWN))
                    or not page.find_element(By.ID, "touch-numbers").is_displayed()
                ),
                15,
                "no touch",
            )
        finally:
            page.set_window_size(size["width"], size["height"])


SEQS = iter(range(4, 10_000))


def rows(page: Chrome) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = js(page, ROWS)
    return found
