"""What the page says of contacts: their numbers, list and names, and a touch without depth."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from support.patience import wait_until
from support.published_sensor import DISC, PublishedSensor, bump, unmeasured
from support.shown_page import NEEDS_A_BROWSER, js, opened, picture, shows, text, until_shown
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Reconstruction, Touch
from tacshade_edge.wire import codec, messages
from tacshade_edge.wire.sensor_topics import ContactEvent

pytestmark = NEEDS_A_BROWSER

ROWS = """[...document.querySelectorAll("#touch-numbers > div")].map((row) => ({
  name: row.querySelector("dt").textContent,
  value: row.querySelector("dd").textContent,
  title: row.title,
  bar: row.querySelector("i").hidden
    ? null : ["left", "width"].map((end) => row.querySelector("i").style[end])}))"""
KNOWN = Touch(
    {"depth_mm": 1.5, "tilt_x_deg": -8.0, "force_z_n": 2.5},
    {"depth_mm": 0.25, "tilt_x_deg": 1.0, "force_z_n": 0.5},
)
OUTSIDE = Touch(
    {"depth_mm": 1.5, "tilt_x_deg": -8.0, "force_z_n": None},
    {"depth_mm": 0.25, "tilt_x_deg": 1.0, "force_z_n": None},
    Reason(ReasonCode.TOUCH_RANGE, "outside the labelled range: force_z_n"),
)


def touched(seq: int, touch: Touch | None) -> Reconstruction:
    return replace(bump(seq, 1.5 if touch else 0.0, DISC.row_c, DISC.col_c, 4), touch=touch)


def test_numbers_have_their_intervals_and_what_is_not_known_says_why(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    opened(page, address)
    assert not page.find_element(By.ID, "touch").is_displayed()
    page.execute_script("document.getElementById('touch').scrollIntoView()")
    until_shown(page, sensor, lambda: touched(7, KNOWN), 7)
    wait_until(lambda: sensor.show(touched(7, KNOWN)) or len(rows(page)) == 3, 15, "the touch")
    depth, tilt, force = rows(page)
    assert [row["name"] for row in (depth, tilt, force)] == ["depth", "tilt x", "force z"]
    assert [row["value"] for row in (depth, tilt, force)] == [
        "1.50 ± 0.25 mm",
        "-8.0 ± 1.0 °",
        "2.50 ± 0.50 N",
    ]
    assert depth["title"] == "One standard deviation; the bar is from −2 to 2 mm"
    assert [float(part.removesuffix("%")) for part in depth["bar"]] == pytest.approx(
        [50 + 50 * 1.25 / 2, 100 * 0.25 / 2]
    )
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

    until_shown(page, sensor, lambda: touched(10, None), 10)
    shows(page, "touch-words", "nothing touches")


def rows(page: Chrome) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = js(page, ROWS)
    return found


def test_contacts_are_listed_newest_first(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    page.get(f"{address}#drawn")
    begun = ContactEvent(
        type="new",
        id=1,
        t_ns=4_000_000_000,
        wall_ns=1,
        start_ns=1_000_000_000,
        depth_max_mm=1.5,
    )
    ended = replace(begun, type="end", end_ns=3_500_000_000, slip=2, reason_code="torn")
    events = [codec.encode_json(each) for each in (begun, ended, replace(begun, id=2))]
    damaged = json.loads(events[-1]) | {"id": "x"}
    rows = (
        "return [...document.querySelectorAll('#lived-list tr')].map((row) => "
        "row.innerText.split('\\t'))"
    )

    def listed() -> bool:
        for payload in (*events, json.dumps(damaged).encode()):
            sensor.publish("event/contact", payload)
        return len(page.execute_script(rows)) == 3

    wait_until(listed, 15, "the list")
    page.execute_script("document.getElementById('lived').open = true")
    _, second, first = page.execute_script(rows)
    assert (second[0], second[2], second[3]) == ("2", "3.0", "1.50")
    assert (first[0], first[2], first[-1]) == ("1", "2.5", "slips")


def test_taught_objects_are_named_until_the_contact_ends(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    page.get(f"{address}#drawn")
    event = {"name": "nut_m8", "probability": 0.973, "label": 1, "t_ns": 1, "seq": 1}
    bad = ({"name": "<b>"}, {"name": 7}, {"probability": 2}, {"label": "x"})

    def named() -> str:
        for more in ({}, *bad, {"name": "key", "label": 2, "probability": 0.5}):
            sensor.publish("event/object", codec.encode_json(event | more))
        found = page.find_element(By.ID, "n-name")
        return found.text if found.is_displayed() else ""

    wait_until(lambda: named() == "nut_m8 97 %, key 50 %", 15, "the names")
    colours = "[...document.querySelectorAll('#n-name .dot')].map((dot) => dot.style.background)"
    assert js(page, colours) == ["rgb(230, 159, 0)", "rgb(255, 95, 162)"], "those of the points"

    def unnamed() -> bool:
        sensor.publish("contact", codec.encode_json({"t_ns": 2, "seq": 2, "contact": 0}))
        return page.find_element(By.ID, "n-name").text == ""

    wait_until(unnamed, 15, "no name")


def map_says(page: Chrome) -> tuple[str, bool]:
    """The words on the map, empty if hidden, and whether its rim has the colour of a touch
    of unknown depth.
    """
    return text(page, "free"), bool(
        js(page, "document.querySelector('.is-touched #disc') !== null")
    )


def test_a_touch_of_unknown_depth_is_neither_contact_nor_none(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    opened(page, address)
    until_shown(page, sensor, lambda: bump(7, 0.0, DISC.row_c, DISC.col_c, 4), 7)
    shows(page, "n-contact", "none")
    assert map_says(page) == ("nothing touches", False)

    until_shown(page, sensor, lambda: unmeasured(8), 8)
    shows(page, "n-contact", "touched, depth unknown")
    assert map_says(page) == ("touched, depth unknown", True)
    assert text(page, "n-depth") == text(page, "n-slip") == ""
    light = page.find_element(By.ID, "n-contact").value_of_css_property("color")

    until_shown(page, sensor, lambda: bump(9, 2.0, DISC.row_c, DISC.col_c, 4), 9)
    shows(page, "n-contact", "1 object")
    assert map_says(page) == ("", False)
    assert page.find_element(By.ID, "n-contact").value_of_css_property("color") != light

    # The map of the release is lost; only `contact` comes.
    lost = messages.encode_contact(unmeasured(10), fps=30.0)
    told = ("touched, depth unknown", True)
    wait_until(lambda: sensor.publish("contact", lost) or map_says(page) == told, 15, "the touch")
