"""The page in headless Chromium, against the real broker, daemon and dashboard process.

::

    TACSHADE_SCREENSHOTS=docs/images .venv/bin/python -m pytest tests/dashboard/

also writes the pictures of docs/dashboard.md.
"""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from selenium.webdriver import ActionChains, Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select
from support.browser import browser, errors
from support.certificate import certificate
from support.dashboard_process import dashboard
from support.growing_map import PAD, GrowingMap, scan
from support.mqtt_rig import Broker, Subscriber, free_port
from support.patience import patience, wait_until
from support.published_hand import COLS, DISC, PublishedHand, bump, dragged, uncertain
from support.published_hand import calibration as calibrated_hand
from support.shown_page import NEEDS_A_BROWSER, daemon, drawn, js, opened, picture, shows, text, until_shown

from tacshade_edge.core.profiles import DEFAULT, PROFILES
from tacshade_edge.protocol import messages, wire
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.simulator.scene import SimulatedSensor
from tacshade_edge.simulator.script import demonstration
from tacshade_edge.types import Slip

pytestmark = NEEDS_A_BROWSER
SCRIPT = demonstration()
SOLVER_RATIO = 0.25  # what `fast` may be off on a ball; the daemon's own test on a camera has the same


def pressed_mm(seq: int) -> float:
    """The greatest h that the simulated hand makes in this frame."""
    return float(SimulatedSensor().frame(SCRIPT.at(seq)).skin.height_mm.max())


def held(seq: int | None) -> str:
    """Name of what is pressed to its full depth in this frame; empty while it moves and without contact."""
    now, before, after = (SCRIPT.at((seq or 1) + k) for k in (0, -1, 1))
    return now[0].shape.name if seq and now and now == before == after else ""


def test_the_drawn_depth_is_the_pressed_depth(page: Chrome, tmp_path: Path, calibration: Path) -> None:
    """From the colours of the canvas back to mm, against the payload and against what the simulated hand pressed."""
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        Subscriber(broker.port, "tacshade/left-index/height") as seen,
    ):
        opened(page, address)
        assert page.find_element(By.ID, "waiting").is_displayed()
        with daemon(tmp_path, calibration, broker.port):
            shots: dict[str, tuple[int, float, float, str]] = {}

            def look() -> bool:
                # One script, so that all is of one map. The ball is the one object that the profile was fitted to.
                seq, peak, scale, pixels = js(
                    page,
                    "[tacshade.seq, tacshade.drawnPeak(), tacshade.scale_mm, window.cells.toDataURL()]",
                )
                name = "free" if peak == 0 else held(seq)
                if name:
                    shots[name] = (seq, peak, scale, pixels)
                return {"ball", "cube", "small_crescent"} <= set(shots)

            wait_until(look, 90, "cube, crescent and ball were shown")
            picture(page, "dashboard", (1000, 1240))
            assert text(page, "state") == "online"
            assert Select(page.find_element(By.ID, "profile")).first_selected_option.text == DEFAULT
            sent = {h.seq: h for h in map(wire.decode, seen.of("tacshade/left-index/height"))}
    for name, (seq, peak, scale, _) in shots.items():
        height = sent[seq]
        assert isinstance(height, wire.HeightMessage)
        # Half a colour, half a step of the wire.
        assert peak == pytest.approx(float(np.nanmax(height.height_mm)), abs=scale / 255 / 2 + 0.0005), name
    assert shots["ball"][1] == pytest.approx(pressed_mm(shots["ball"][0]), rel=SOLVER_RATIO)
    assert len({pixels for *_, pixels in shots.values()}) == len(shots)


def test_every_cell_has_the_colour_of_its_depth(page: Chrome, tmp_path: Path) -> None:
    """A known shape: where it lies, how it falls off, what is outside, and what the pointer reads."""
    row, col = DISC.row_c + 40, DISC.col_c - 60
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        until_shown(page, hand, lambda: uncertain(bump(7, 2.6, row, col), 0.125), 7)
        truth = bump(7, 2.6, row, col).height.height_mm
        scale = js(page, "tacshade.scale_mm")
        assert scale == 3
        for r, c in [(row, col), (row + 50, col), (row, col + 90), (DISC.row_c - 180, DISC.col_c)]:
            shown = js(page, f"tacshade.depthAt({r}, {c})")
            assert shown == pytest.approx(float(truth[round(r), round(c)]), abs=scale / 255), (r, c)
        assert js(page, f"tacshade.depthAt({DISC.row_c}, {DISC.col_c + DISC.radius_px + 1})") is None  # NaN
        assert js(page, f"tacshade.depthAt(1, {COLS - 1})") is None

        canvas = page.find_element(By.ID, "cells")
        to_screen = canvas.rect["width"] / (2 * DISC.radius_px)
        ActionChains(page).move_to_element_with_offset(canvas, round(-60 * to_screen), round(40 * to_screen)).perform()
        shows(page, "cursor", "2.6")
        shows(page, "cursor", "± 0.13 mm")
        shows(page, "cursor", "x -")
        shows(page, "n-depth", "2.60")
        shows(page, "objects", "object 1")

        Select(page.find_element(By.ID, "range")).select_by_value("10")
        assert js(page, "tacshade.scale_mm") == 10
        assert js(page, f"tacshade.depthAt({row}, {col})") == pytest.approx(2.6, abs=10 / 255)
        shows(page, "ticks", "10 mm")
        Select(page.find_element(By.ID, "range")).select_by_value("auto")

        until_shown(page, hand, lambda: bump(8, 0.0, row, col), 8)  # released
        assert js(page, "tacshade.drawnPeak()") == 0
        assert text(page, "objects") == ""


def test_arrows_show_how_the_skin_was_dragged_and_dots_when_it_slides(page: Chrome, tmp_path: Path) -> None:
    row, col = DISC.row_c + 10, DISC.col_c - 20
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        until_shown(page, hand, lambda: dragged(bump(7, 2.6, row, col, 4), 2.0, -1.0), 7)
        wait_until(lambda: js(page, "tacshade.arrows") > 0, 15, "arrows")
        path = js(page, "document.getElementById('arrows').getAttribute('d')")
        shafts = [tuple(map(float, shaft)) for shaft in re.findall(r"M(\S+) (\S+)L(\S+) (\S+)M", path)]
        assert len(shafts) == js(page, "tacshade.arrows") < 200
        longest = max(shafts, key=lambda s: math.hypot(s[2] - s[0], s[3] - s[1]))
        mm_per_px = calibrated_hand().geometry.mm_per_px
        assert (longest[2] - longest[0]) * mm_per_px == pytest.approx(2.0, abs=0.1)
        assert (longest[3] - longest[1]) * mm_per_px == pytest.approx(-1.0, abs=0.1)
        assert math.hypot(longest[2] - col, longest[3] - row) < 25
        picture(page, "arrows", (1280, 900))
        until_shown(page, hand, lambda: dragged(bump(8, 2.6, row, col, 4), 2.0, -1.0, Slip.FULL), 8)
        wait_until(lambda: js(page, "tacshade.slips") > 0, 15, "a slip in the chart")
        until_shown(page, hand, lambda: bump(9, 0.0, row, col, 4), 9)
        assert js(page, "tacshade.arrows") == 0


def test_it_recovers_from_a_broker_restart(page: Chrome, tmp_path: Path, calibration: Path) -> None:
    with Broker(tmp_path) as broker, dashboard(f"127.0.0.1:{broker.port}") as address:
        with daemon(tmp_path, calibration, broker.port):
            opened(page, address)
            drawn(page)
            broker.kill()
            shows(page, "link", "Not connected: broker 127.0.0.1")
            shows(page, "link", "connection refused; trying again")
            assert not page.find_element(By.ID, "rezero").is_enabled()
            shows(page, "stale", "s ago")
            picture(page, "dashboard-away", (760, 560))
            broker.start()
            shows(page, "link", "Connected")
            drawn(page)
            wait_until(lambda: text(page, "stale") == "", 10, "no longer stale")
        shows(page, "state", "stopped")
        assert not page.find_element(By.ID, "rezero").is_enabled()


def test_it_recovers_from_a_restart_of_its_server(chromium: Chrome, tmp_path: Path) -> None:
    with Broker(tmp_path) as broker, PublishedHand(broker.port):
        words = f"127.0.0.1:{broker.port}", "--http", str(free_port())
        with dashboard(*words) as address:
            opened(chromium, address)
        shows(chromium, "link", "the dashboard's server does not answer")
        with dashboard(*words):
            shows(chromium, "link", "Connected")
            shows(chromium, "state", "online")
            # The browser itself complains of every attempt that nobody answered, and nothing else does.
            assert [e for e in errors(chromium) if "ERR_CONNECTION_REFUSED" not in e] == []
            chromium.get("about:blank")


def test_profile_and_zero_are_changed_through_requests(page: Chrome, tmp_path: Path, calibration: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        daemon(tmp_path, calibration, broker.port),
    ):
        opened(page, address)
        profile = Select(page.find_element(By.ID, "profile"))
        wait_until(lambda: page.find_element(By.ID, "profile").is_enabled(), 15, "the hand is online")
        *others, dearest = [option.text for option in profile.options]
        assert others == [name for name in PROFILES if name != "paper"]
        assert dearest == "paper (200 times slower, less exact)"
        profile.select_by_value("paper")
        shows(page, "answer", "The profile is paper.")
        wait_until(lambda: page.find_element(By.ID, "profile").is_enabled(), 15, "the answer")
        Select(page.find_element(By.ID, "profile")).select_by_value("fast")
        shows(page, "answer", "The profile is fast.")

        page.find_element(By.ID, "rezero").click()
        shows(page, "answer", "Zero is new", 30)
        wait_until(lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "it may be asked again")


def test_the_profile_that_auto_uses_now_is_shown_as_it_changes(page: Chrome, tmp_path: Path) -> None:
    def shown() -> str:
        return str(js(page, "document.getElementById('profile').selectedOptions[0].text"))

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
        Subscriber(broker.port, "tacshade/+/req/+") as seen,
    ):
        opened(page, address)
        wait_until(lambda: page.find_element(By.ID, "profile").is_enabled(), 15, "the hand is online")
        assert shown() == "fast"
        for profile in ("accurate", "fast"):
            hand.tell_info(profile, profiles=("fast", "accurate", "auto"), choice="auto")
            wait_until(lambda profile=profile: shown() == f"auto (now {profile})", 15, f"auto uses {profile}")
        Select(page.find_element(By.ID, "profile")).select_by_value("fast")
        asked = json.loads(seen.wait_for("tacshade/drawn/req/profile")[0])
        assert asked["profile"] == "fast"
        hand.tell_info("fast", profiles=("fast", "accurate", "auto"), choice="fast")
        hand.tell(
            "res/profile",
            json.dumps({"transaction": asked["transaction"], "ok": True, "result": {"profile": "fast"}}).encode(),
        )
        shows(page, "answer", "The profile is fast.")
        wait_until(lambda: shown() == "fast", 15, "a fixed profile")


def test_a_hand_that_is_not_calibrated_yet_shows_its_picture_and_why(page: Chrome, tmp_path: Path) -> None:
    missing = Reason(ReasonCode.NOT_CALIBRATED, "not calibrated: found no file")
    picture = cv2.imencode(".jpg", np.full((240, 320), 90, np.uint8))[1].tobytes()
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        wait_until(lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "the hand is online")
        hand.tell_info("fast", profiles=("fast",), missing=missing)
        hand.tell("state", b"degraded", retain=True)
        hand.tell("status/camera", messages.encode_status("unusable", missing), retain=True)
        hand.tell("health", messages.encode_health({"invalid_reason": missing.text}))
        hand.tell("preview", picture)
        shows(page, "state", "degraded camera: not calibrated: found no file")
        wait_until(lambda: page.find_element(By.ID, "picture").is_displayed(), 15, "the picture")
        assert not any(page.find_element(By.ID, name).is_displayed() for name in ("height", "space", "numbers"))
        assert not page.find_element(By.ID, "rezero").is_enabled()
        hand.tell_info("fast", profiles=("fast",))
        wait_until(lambda: page.find_element(By.ID, "height").is_displayed(), 15, "calibrated")


def test_what_a_hand_refuses_or_does_not_answer_is_told(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
        Subscriber(broker.port, "tacshade/+/req/+") as seen,
    ):
        opened(page, address)
        wait_until(lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "the hand is online")
        page.find_element(By.ID, "rezero").click()
        asked = json.loads(seen.wait_for("tacshade/drawn/req/reference")[0])
        hand.tell("res/reference", json.dumps({"transaction": "of somebody else", "ok": True, "result": {}}).encode())
        hand.tell("res/reference", b"no JSON")
        hand.tell(
            "res/reference", json.dumps({"transaction": asked["transaction"], "ok": False, "error": "touched"}).encode()
        )
        wait_until(lambda: text(page, "answer") == "touched", 15, "the error")
        page.find_element(By.ID, "rezero").click()
        shows(page, "answer", "no answer within 8 s", 20)


def test_several_hands(page: Chrome, tmp_path: Path) -> None:
    def tabs() -> list[str]:
        # in one step: the page replaces the tabs when a hand tells its state
        return list(js(page, "[...document.querySelectorAll('#hands button')].map(tab => tab.innerText.trim())"))

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port, "thumb") as thumb,
        PublishedHand(broker.port, "index") as index,
    ):
        opened(page, address, "thumb")
        wait_until(lambda: tabs() == ["index", "thumb"], 10, "both tabs")
        until_shown(page, thumb, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        index.show(bump(99, 0.9, 200, 300, step_px=4))
        thumb.show(bump(2, 1.0, 200, 300, step_px=4))
        wait_until(lambda: js(page, "tacshade.seq === 2"), 10, "only the chosen hand's")
        page.find_elements(By.CSS_SELECTOR, "#hands button")[0].click()
        assert js(page, "[tacshade.sensor, tacshade.seq]") == ["index", None]
        until_shown(page, index, lambda: bump(100, 0.9, 200, 300, step_px=4), 100)
        assert js(page, "tacshade.drawnPeak()") == pytest.approx(0.9, abs=0.01)
        assert page.current_url.endswith("#index")
        assert page.title.startswith("index")
        index.tell("state", b"offline", retain=True)
        shows(page, "state", "offline")
        assert js(page, "tacshade.sensor") == "index"  # the page does not jump away from what one looks at


def test_strange_messages_are_counted_and_shown_as_text(page: Chrome, tmp_path: Path) -> None:
    evil = '<img src=x onerror="document.title=1"> & <b>bold</b>'
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        until_shown(page, hand, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        assert js(page, "tacshade.undecodable") == 0
        sound = wire.encode_height(bump(2, 2.0, 200, 300, step_px=4), calibration_crc32=1)
        for count, damaged in enumerate([b"", sound[:50], sound[:-1], sound[:200] + b"!" + sound[201:]], 1):
            hand.tell("height", damaged)
            wait_until(lambda count=count: js(page, "tacshade.undecodable") == count, 10, f"{count} counted")  # type: ignore[misc]
        for topic in ("health", "contact", "status/camera", "info"):
            for payload in (b"{", b"null", b"\xff\xfe", b"[]"):
                hand.tell(topic, payload)
        hand.tell("preview", b"no JPEG")
        hand.tell("status/camera", json.dumps({"state": "away", "reason": evil, "device": {"a": [evil]}}).encode())
        hand.tell("health", json.dumps({evil: evil, "temperature_c": {"cpu": 61.5}}).encode())
        shows(page, "parts", evil)
        shows(page, "state", evil)
        shows(page, "tables", "61.5")
        until_shown(page, hand, lambda: bump(3, 1.0, 200, 300, step_px=4), 3)
        assert page.title == "drawn – TacShade"


def mapping(hand: PublishedHand, name: str, **corner_mm: float) -> GrowingMap:
    return GrowingMap(lambda topic, payload: hand.tell(topic, payload, retain=True), name, **corner_mm)


def until_mapped(page: Chrome, name: str, revision: int) -> None:
    told = "tacshade.stitched && [tacshade.stitched.name, tacshade.stitched.revision]"
    wait_until(lambda: js(page, told) == [name, revision], 15, f"revision {revision} of {name} on the screen")


def frame_of(page: Chrome) -> Any:
    """Where the map's frame and what is below it are."""
    return js(page, "['stitched-map', 'health'].map(id => document.getElementById(id).getBoundingClientRect().top)")


def test_the_map_grows_with_its_revisions(page: Chrome, tmp_path: Path) -> None:
    """From the first press to the final map: every place has the colour of its z, elsewhere there is nothing."""
    x, y = 400.0, -250.0  # of the pad's corner in the base frame
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        wait_until(lambda: js(page, "tacshade.sensor"), 10, "the hand")
        assert not page.find_element(By.ID, "stitched").is_displayed()
        growing = mapping(hand, "pad-1", x_mm=x, y_mm=y)
        growing.press((14.0, 14.0))
        until_mapped(page, "pad-1", 1)
        assert page.find_element(By.ID, "stitched").is_displayed()
        assert text(page, "stitched-name") == "pad-1, growing"
        for words in ("presses\n1", "revision\n1", "0.25 mm apart", "size\n12."):
            shows(page, "stitched-facts", words)
        assert js(page, f"tacshade.zAt({x + 40}, {y + 14})") is None  # NaN: not yet
        before = frame_of(page)
        places = scan()
        growing.press(*places[:30])
        until_mapped(page, "pad-1", 2)
        growing.press(*places[30:])
        until_mapped(page, "pad-1", 3)
        assert frame_of(page) == before  # nothing moves while it grows
        low, high = 0.0, 1.5
        assert text(page, "stitched-ticks").split() == ["0", "0.375", "0.75", "1.125", "1.5", "mm"]
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
        width_mm, length_mm = js(page, "[tacshade.stitched.width_mm, tacshade.stitched.length_mm]")
        px_per_mm = min(canvas.rect["width"] / width_mm, canvas.rect["height"] / length_mm)
        right = (x + 60.0 - corner[0] - width_mm / 2) * px_per_mm
        down = -(y + 54.1 - corner[1] - length_mm / 2) * px_per_mm
        ActionChains(page).move_to_element_with_offset(canvas, round(right), round(down)).perform()
        shows(page, "stitched-cursor", "z 1.50 mm")
        place = text(page, "stitched-cursor").split("x ")[1].split(" mm")[0]
        assert [float(v) for v in place.split(", y ")] == pytest.approx([x + 60.0, y + 54.1], abs=0.6)
        picture(page, "dashboard-map", (760, 740), "stitched")


def test_a_map_that_was_told_before_is_there_at_once(page: Chrome, tmp_path: Path) -> None:
    """Retained: the final map of one session, then beside it the first press of the next, and of another hand."""
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
        PublishedHand(broker.port, "other") as other,
    ):
        first = mapping(hand, "first")
        first.press((20.0, 20.0), (30.0, 20.0))
        first.end("/maps/first")
        opened(page, address, "drawn")
        until_mapped(page, "first", 2)
        assert text(page, "stitched-name") == "first, final"
        mapping(hand, "second").press((60.0, 40.0))
        until_mapped(page, "second", 1)
        assert js(page, "tacshade.zAt(20, 20)") is None
        page.refresh()
        until_mapped(page, "second", 1)
        assert text(page, "stitched-name") == "second, growing"

        wait_until(lambda: len(page.find_elements(By.CSS_SELECTOR, "#hands button")) == 2, 10, "both hands")
        page.find_elements(By.CSS_SELECTOR, "#hands button")[1].click()
        assert js(page, "[tacshade.sensor, tacshade.stitched]") == ["other", None]
        assert not page.find_element(By.ID, "stitched").is_displayed()
        mapping(other, "third").press((60.0, 40.0))
        until_mapped(page, "third", 1)


def test_a_stitching_session_is_commanded_through_requests(page: Chrome, tmp_path: Path) -> None:
    def status(state: str, name: str, presses: int) -> None:
        hand.tell(
            "status/stitching", messages.encode_status(state, None, {"name": name, "presses": presses}), retain=True
        )

    def asked(count: int, result: dict[str, object], error: str = "") -> dict[str, object]:
        body = json.loads(seen.wait_for("tacshade/drawn/req/stitch", count, 15)[-1])
        answer = {"ok": False, "error": error} if error else {"ok": True, "result": result}
        hand.tell("res/stitch", json.dumps({"transaction": body.pop("transaction"), **answer}).encode())
        return dict(body)

    def press(name: str) -> None:
        button = page.find_element(By.NAME, name)
        wait_until(lambda: button.is_displayed() and button.is_enabled(), 15, f"{name} can be pressed")
        button.click()

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
        Subscriber(broker.port, "tacshade/+/req/+") as seen,
    ):
        opened(page, address)
        wait_until(lambda: page.find_element(By.ID, "rezero").is_enabled(), 15, "the hand is online")
        assert not page.find_element(By.ID, "session").is_displayed()  # one without poses has no sessions
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
        shows(page, "answer", "Press 4 is added.")
        press("abort")
        page.switch_to.alert.dismiss()
        status("ending", "pad-1", 4)
        wait_until(lambda: not page.find_element(By.NAME, "end").is_enabled(), 15, "nothing more while it ends")
        status("open", "pad-1", 4)
        press("end")
        assert asked(4, {"name": "pad-1", "presses": 4, "used": 3}) == {"action": "end"}
        shows(page, "answer", "The map of pad-1 is made: 3 of 4 presses used.")
        press("abort")
        assert "4 presses are deleted" in page.switch_to.alert.text
        page.switch_to.alert.accept()
        assert asked(5, {"name": "pad-1", "presses": 4}) == {"action": "abort"}
        shows(page, "answer", "Session pad-1 is gone.")
        status("idle", "", 0)
        wait_until(lambda: page.find_element(By.NAME, "begin").is_displayed(), 15, "another can begin")


def test_a_map_that_makes_no_sense_is_counted_and_not_drawn(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        wait_until(lambda: js(page, "tacshade.sensor"), 10, "the hand")
        growing = mapping(hand, "<b>good</b>")
        growing.press((20.0, 20.0))
        until_mapped(page, "<b>good</b>", 1)
        assert text(page, "stitched-name") == "<b>good</b>, growing"
        fine = {"points": 5, "x0_mm": 0, "y0_mm": 0, "width_mm": 9, "length_mm": 9, "spacing_mm": 0.25}
        for count, wrong in enumerate(({"width_mm": None}, {"spacing_mm": 0}, {"x0_mm": "here"}, {"length_mm": -1}), 1):
            told = json.dumps(fine | wrong | {"revision": 10 + count})
            points = np.zeros((5, 3), np.float32)
            cloud = wire.encode_map_cloud(points, revision=10 + count, calibration_crc32=1, t_ns=1, wall_ns=2)
            hand.tell("map/cloud", cloud)
            hand.tell("map/revision", told.encode())
            wait_until(lambda count=count: js(page, "tacshade.undecodable") == count, 10, f"{count}, {told}")  # type: ignore[misc]
        hand.tell("map/final", b"[]")
        for topic, payload in (("map/revision", b"{"), ("map/final", b"null"), ("map/cloud", cloud[:-1])):
            count += 1
            hand.tell(topic, payload)
            wait_until(lambda count=count: js(page, "tacshade.undecodable") == count, 10, f"{count}, {topic}")  # type: ignore[misc]
        assert js(page, "tacshade.stitched.name") == "<b>good</b>"
        growing.press((30.0, 20.0))
        until_mapped(page, "<b>good</b>", 2)


def test_a_broker_with_users_asks_for_one(page: Chrome, tmp_path: Path) -> None:
    users = {"eve": "right"}
    with (
        Broker(tmp_path, users=users) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port, "drawn", "eve", "right") as hand,
    ):
        page.get(address)
        shows(page, "login", "wants a user and password")
        for name, word in (("eve", "wrong"), ("eve", "right")):
            field = page.find_element(By.NAME, "username")
            field.clear()
            field.send_keys(name)
            page.find_element(By.NAME, "password").send_keys(word)
            page.find_element(By.CSS_SELECTOR, "#login button").click()
            shows(page, "link" if word == "right" else "login-why", "Connected" if word == "right" else "refused")
        assert not page.find_element(By.ID, "login").is_displayed()
        until_shown(page, hand, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        page.refresh()  # kept for this tab
        shows(page, "link", "Connected")
        js(page, "sessionStorage.clear()")


@pytest.mark.parametrize("tls", [False, True])
def test_a_page_that_is_opened_to_a_network_wants_its_token_and_only_looks(tmp_path: Path, tls: bool) -> None:
    words = ["--host", "0.0.0.0", "--token-file", str(tmp_path / "token")]
    if tls:
        words += [f"--{name}={path}" for name, path in zip(("certificate", "key"), certificate(tmp_path), strict=True)]
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", *words) as told,
        PublishedHand(broker.port) as hand,
        Subscriber(broker.port, "tacshade/+/req/+") as seen,
        browser(tmp_path / "chromium", "--ignore-certificate-errors") as page,
    ):
        address, _, token = re.sub(r"//[^:]+", "//127.0.0.1", told).partition("login#")
        page.get(address)
        wait_until(lambda: page.current_url == f"{address}login", 15, "the login")
        page.find_element(By.NAME, "token").send_keys("of yesterday\n")
        shows(page, "login-why", "expected the token")
        assert [line for line in errors(page) if "401" not in line] == []
        page.get("about:blank")
        page.get(f"{address}login#{token}")
        wait_until(lambda: page.current_url == address, 15, "the page")
        shows(page, "link", "Connected")
        assert js(page, "document.cookie") == ""
        until_shown(page, hand, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        shows(page, "read-only", "Read-only")
        wait_until(lambda: js(page, "tacshade.sensor"), 10, "the hand")
        assert not page.find_element(By.ID, "rezero").is_enabled()
        assert not page.find_element(By.ID, "profile").is_enabled()
        until_shown(page, hand, lambda: bump(2, 0.0, 200, 300, step_px=4), 2)
        # In one go: the page disables it again with the next message.
        page.execute_script("const it = document.getElementById('rezero'); it.disabled = false; it.click()")
        shows(page, "link", "read-only: requests are not passed on here")
        shows(page, "link", "Connected")
        assert seen.messages == []
        assert errors(page) == []
        picture(page, "login-read-only", (760, 900), "control")


def test_without_webgl_the_rest_goes_on(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
        browser(tmp_path / "chromium", "--disable-3d-apis") as page,
    ):
        opened(page, address)
        until_shown(page, hand, lambda: bump(1, 1.5, 200, 300), 1)
        assert "no WebGL" in text(page, "view")
        assert js(page, "tacshade.drawnPeak()") == pytest.approx(1.5, abs=0.01)
        assert errors(page) == []


def test_the_skin_is_drawn_in_space(page: Chrome, tmp_path: Path) -> None:
    """Pixels of the 3-D view: something is there, it follows the press, and the boxes switch its parts."""

    def pixels() -> str:
        return str(page.find_element(By.ID, "view").screenshot_as_base64)

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port) as hand,
    ):
        opened(page, address)
        assert js(page, "tacshade.webgl")
        wait_until(lambda: js(page, "tacshade.sensor"), 10, "the hand")
        empty = pixels()
        until_shown(page, hand, lambda: bump(1, 2.0, 200, 300), 1)
        wait_until(lambda: pixels() != empty, 10, "the skin")
        pressed = pixels()
        page.find_element(By.ID, "show-cloud").click()
        wait_until(lambda: pixels() != pressed, 10, "without the objects")
        page.find_element(By.ID, "show-skin").click()
        page.find_element(By.ID, "show-cloud").click()
        wait_until(lambda: pixels() not in (empty, pressed), 10, "the objects alone")


@pytest.mark.parametrize(
    ("name", "size_px", "flags"), [("phone", (400, 850), ()), ("dark", (1400, 1000), ("--force-dark-mode",))]
)
def test_it_fits_the_screen(tmp_path: Path, name: str, size_px: tuple[int, int], flags: tuple[str, ...]) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedHand(broker.port, "left-index") as hand,
        browser(tmp_path / "chromium", *flags, size_px=size_px) as page,
    ):
        page.set_window_size(*size_px)
        opened(page, address)
        until_shown(page, hand, lambda: bump(1, 2.4, 200, 360, step_px=4), 1)
        growing = mapping(hand, "a" * 60)
        growing.press(*scan())
        growing.end("/var/lib/tacshade-edge/maps/" + "a" * 60)
        until_mapped(page, "a" * 60, 2)
        width, scrolled = js(page, "[document.documentElement.clientWidth, document.documentElement.scrollWidth]")
        assert scrolled <= width
        map_width = page.find_element(By.ID, "cells").rect["width"]
        assert min(300, 0.8 * width) <= map_width <= width
        dark = js(page, "getComputedStyle(document.documentElement).backgroundColor") == "rgb(20, 23, 27)"
        assert dark == (name == "dark")
        if name == "phone":
            picture(page, "dashboard-phone")
        assert errors(page) == []


def test_maps_of_full_size_are_drawn_as_they_come() -> None:
    """Thirty 640x480 maps a second: what the machine cannot draw is dropped and counted, and does not queue up.

    What comes is drawn or replaced by a newer one, and late by no more maps than broker (20 messages) and sockets (to
    70 MB of buffers) can hold on the way: in maps, so that it holds at any machine's pace.
    """
    root = Path(__file__).parents[2]
    command = [sys.executable, "tools/bench_dashboard.py", "--seconds", "5", "--json"]
    environment = {**os.environ, "PYTHONPATH": str(root / "tests")}
    done = subprocess.run(command, cwd=root, env=environment, stdout=subprocess.PIPE, timeout=patience(120), check=True)
    figures = json.loads(done.stdout)
    assert (figures["unaccounted"], figures["undecodable"], figures["console_errors"]) == (0, 0, []), figures
    assert figures["drawn_per_s"] > 0, figures
    assert figures["age_ms"]["p50"] * figures["heard_per_s"] / 1000 < 130, figures
