"""The page's map: how it grows, and the session that it commands."""

from __future__ import annotations

import json

import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.by import By

from support.growing_map import PAD, scan
from support.mqtt_rig import Subscriber
from support.patience import wait_until
from support.published_sensor import PublishedSensor
from support.shown_page import (
    NEEDS_A_BROWSER,
    js,
    mapping,
    opened,
    picture,
    shows,
    text,
    until_mapped,
)
from tacshade_edge.wire import messages

pytestmark = NEEDS_A_BROWSER


def test_the_map_grows_with_its_revisions(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    """From the first press to the final map: every place has the colour of its z,
    elsewhere there is nothing.
    """
    x, y = 400.0, -250.0  # of the pad's corner in the base frame
    opened(page, address)
    wait_until(lambda: js(page, "tacshade.sensor"), 10, "the sensor")
    assert not page.find_element(By.ID, "stitched").is_displayed()
    growing = mapping(sensor, "pad-1", x_mm=x, y_mm=y)
    growing.press((14.0, 14.0))
    until_mapped(page, "pad-1", 1)
    assert page.find_element(By.ID, "stitched").is_displayed()
    assert text(page, "stitched-name") == "pad-1, growing"
    for words in ("presses\n1", "revision\n1", "0.25 mm apart", "size\n12."):
        shows(page, "stitched-facts", words)
    assert js(page, f"tacshade.zAt({x + 40}, {y + 14})") is None  # NaN: not yet
    places = scan()
    growing.press(*places[:30])
    until_mapped(page, "pad-1", 2)
    growing.press(*places[30:])
    until_mapped(page, "pad-1", 3)
    low, high = 0.0, 1.5
    assert text(page, "stitched-ticks").split() == ["0", "0.5", "1", "1.5", "mm"]
    for at in [(20.1, 32.1), (20.1, 21.1), (61.6, 20.0), (53.6, 14.0), (60.0, 54.1), (80.1, 28.1)]:
        # Flat around each: points are thinned and cells lie beside them by up to half a spacing.
        truth = float(PAD.height_mm(*(np.array([v]) for v in at))[0])
        shown = js(page, f"tacshade.zAt({x + at[0]}, {y + at[1]})")
        assert shown == pytest.approx(truth, abs=(high - low) / 255 + 0.01), at

    spacing_mm = js(page, "tacshade.stitched.spacing_mm")
    assert spacing_mm > 0.25  # more than 20000 points were touched
    corner = js(page, "[tacshade.stitched.x0_mm, tacshade.stitched.y0_mm]")
    assert js(page, f"tacshade.zAt({corner[0]}, {corner[1]})") is None

    growing.end("/var/lib/tacshade-edge/maps/pad-1", rejected=3)
    until_mapped(page, "pad-1", 4)
    assert text(page, "stitched-name") == "pad-1, final"
    shows(page, "stitched-facts", f"{growing.presses}, 3 left out")
    shows(page, "stitched-facts", "/var/lib/tacshade-edge/maps/pad-1")

    # The pointer, on the bar that stands alone: mm from the canvas's frame and what is drawn in it.
    canvas = page.find_element(By.ID, "stitched-cells")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", canvas)
    width_mm, length_mm = js(page, "[tacshade.stitched.width_mm, tacshade.stitched.length_mm]")
    px_per_mm = min(canvas.rect["width"] / width_mm, canvas.rect["height"] / length_mm)
    right = (x + 60.0 - corner[0] - width_mm / 2) * px_per_mm
    down = -(y + 54.1 - corner[1] - length_mm / 2) * px_per_mm
    ActionChains(page).move_to_element_with_offset(canvas, round(right), round(down)).perform()
    shows(page, "stitched-cursor", "z 1.50 mm")
    place = text(page, "stitched-cursor").split("x ")[1].split(" mm")[0]
    assert [float(v) for v in place.split(", y ")] == pytest.approx([x + 60.0, y + 54.1], abs=0.6)
    picture(page, "dashboard-map", (760, 740), "stitched")


def test_a_stitching_session_is_commanded_through_requests(
    page: Chrome, address: str, sensor: PublishedSensor, seen: Subscriber
) -> None:
    def status(state: str, name: str, presses: int) -> None:
        sensor.publish(
            "status/stitching",
            messages.encode_status(state, None, {"name": name, "presses": presses}),
            retain=True,
        )

    def asked(count: int, result: dict[str, object], error: str = "") -> dict[str, object]:
        body = json.loads(seen.wait_for("tacshade/drawn/req/stitch", count, 15)[-1])
        answer = {"ok": False, "error": error} if error else {"ok": True, "result": result}
        sensor.publish(
            "res/stitch", json.dumps({"transaction": body.pop("transaction"), **answer}).encode()
        )
        return dict(body)

    def press(name: str) -> None:
        button = page.find_element(By.NAME, name)
        wait_until(
            lambda: button.is_displayed() and button.is_enabled(), 15, f"{name} can be pressed"
        )
        button.click()

    opened(page, address)
    wait_until(lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "the sensor is online")
    assert not page.find_element(
        By.ID, "session"
    ).is_displayed()  # one without poses has no sessions
    status("idle", "", 0)
    press("begin")
    assert asked(1, {"name": "20261121-120000"}) == {"action": "begin"}
    shows(page, "answer", "Session 20261121-120000 is open")
    page.find_element(By.NAME, "session").send_keys("pad 1\n")
    assert asked(2, {}, "NAME: found 'pad 1'") == {"action": "begin", "name": "pad 1"}
    shows(page, "answer", "NAME: found 'pad 1'")
    status("open", "pad-1", 3)
    shows(page, "session", "Stitching pad-1: 3 presses")
    assert not page.find_element(By.NAME, "begin").is_displayed()
    press("add")
    assert asked(3, {"press": 4, "frame": 77, "points": 900}) == {"action": "add"}
    shows(page, "answer", "Added press 4.")
    status("open", "pad-1", 4)
    shows(page, "session", "Stitching pad-1: 4 presses")
    press("end")
    assert asked(4, {"name": "pad-1", "presses": 4, "used": 3}) == {"action": "end"}
    shows(page, "answer", "Made the map of pad-1 from 3 of 4 presses.")
    press("abort")
    assert "This deletes its 4 presses" in page.switch_to.alert.text
    page.switch_to.alert.accept()
    assert asked(5, {"name": "pad-1", "presses": 4}) == {"action": "abort"}
    shows(page, "answer", "Deleted session pad-1.")
    status("idle", "", 0)
    wait_until(lambda: page.find_element(By.NAME, "begin").is_displayed(), 15, "another can begin")
