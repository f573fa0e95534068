"""The page while something is amiss: restarts, refusals, nonsense, users, tokens, no WebGL."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from support.browser import browser, errors
from support.dashboard_process import dashboard
from support.mqtt_rig import Broker, Subscriber, certificate
from support.patience import wait_until
from support.published_sensor import PublishedSensor, bump
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
from tacshade_edge.wire import binary, messages

pytestmark = NEEDS_A_BROWSER


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


def test_strange_messages_are_counted_and_shown_as_text(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    evil = '<img src=x onerror="document.title=1"> & <b>bold</b>'
    opened(page, address)
    until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
    unfold_health(page)
    assert js(page, "tacshade.undecodable") == 0
    sound = binary.encode_height(bump(2, 2.0, 200, 300, step_px=4), calibration_crc32=1)
    for count, damaged in enumerate(
        [b"", sound[:50], sound[:-1], sound[:200] + b"!" + sound[201:]], 1
    ):
        sensor.publish("height", damaged)
        wait_until(
            lambda count=count: js(page, "tacshade.undecodable") == count, 10, f"{count} counted"
        )  # type: ignore[misc]
    for topic in ("health", "contact", "status/camera", "info"):
        for payload in (b"{", b"null", b"\xff\xfe", b"[]"):
            sensor.publish(topic, payload)
    sensor.publish("preview", b"no JPEG")
    sensor.publish(
        "status/camera",
        json.dumps({"state": "away", "reason": evil, "device": {"a": [evil]}}).encode(),
    )
    sensor.publish("health", json.dumps({evil: evil, "temperature_c": {"cpu": 61.5}}).encode())
    shows(page, "parts", evil)
    shows(page, "state", evil)
    shows(page, "tables", "61.5")
    until_shown(page, sensor, lambda: bump(3, 1.0, 200, 300, step_px=4), 3)
    assert page.title == "drawn – TacShade"


def test_every_lost_frame_counts_and_a_start_is_no_rate(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    opened(page, address)
    until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
    camera = {"state": "streaming", "fps_asked": 20}
    sensor.publish("status/camera", json.dumps(camera).encode())
    start = {
        "uptime_s": 2,
        "frames": {"captured": 2},
        "source_dropped": 0,
        "delivered_fps": 1.0,
        "latency_ms": {"p50": 600.0, "p99": 670.0},
    }
    sensor.publish("health", json.dumps(start).encode())
    shows(page, "health-words", "starting · no frame lost · up 2 s")
    assert [text(page, name) for name in ("n-fps", "n-latency", "n-latency-99")] == ["", "", ""]
    slow = start | {
        "uptime_s": 9,
        "frames": {"captured": 502, "superseded": 7, "failed": 1},
        "source_dropped": 4498,
        "delivered_fps": 2.0,
        "recorder": {"written": 9, "dropped": 2, "pre_roll_dropped": 1},
    }
    sensor.publish("health", json.dumps(slow).encode())
    lost = "4506 of 5000 frames lost (4498 by the source, 7 replaced by a newer one, 1 failed)"
    shows(page, "health-words", f"2.0 of 20 frames/s · 600 ms · {lost} · 3 frames not recorded")
    assert [text(page, name) for name in ("n-fps", "n-latency", "n-latency-99")] == [
        "2.0",
        "600",
        "",  # still among the latest 512
    ]
    colour = "getComputedStyle(document.getElementById('{}')).color"
    assert js(page, colour.format("n-fps")) != js(page, colour.format("n-latency"))
    sensor.publish("health", json.dumps(slow | {"uptime_s": 40}).encode())
    shows(page, "n-latency-99", "670")


def test_what_ages_is_named_with_its_date(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    opened(page, address)
    until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
    unfold_health(page)
    light = {"amount": 0.21, "limit": 0.5, "unit": "of the light", "until": "2027-04-20"}
    gel = {"amount": 0.031, "limit": 0.2, "unit": "mm", "until": None}
    ageing = {"days": 42, "ageing": ["light"], "wears": {"light": light, "gel": gel, "x": None}}
    health = {"uptime_s": 9, "reference": {"state": "following", "ageing": ageing}}
    sensor.publish("health", json.dumps(health).encode())
    shows(page, "health-words", "ageing: light")
    shows(page, "tables", "21 of 50 %, until 2027-04-20")
    shows(page, "tables", "0.03 of 0.20 mm")
    assert "following" in text(page, "tables")
    ageing |= {"ageing": [], "wears": {}, "days": 3}
    sensor.publish("health", json.dumps(health).encode())
    wait_until(lambda: "ageing" not in text(page, "health-words"), 10, "no word")
    shows(page, "tables", "days seen 3")


def test_what_touches_is_unknown_while_frames_are_unusable(
    page: Chrome, address: str, sensor: PublishedSensor
) -> None:
    opened(page, address)
    until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
    shows(page, "n-contact", "1 object")
    torn = Reason(ReasonCode.TORN, "torn")
    unusable = replace(bump(2, 0.0, 0, 0, step_px=4), valid=False, reason=torn)
    # Without its height, which may be lost.
    sensor.publish("contact", messages.encode_contact(unusable, fps=5.0))
    shows(page, "flags", "frame unusable")
    wait_until(lambda: text(page, "n-contact") == "", 10, "unknown")
    assert text(page, "n-depth") == ""
    assert not page.find_element(By.ID, "free").is_displayed()
    sensor.publish("contact", messages.encode_contact(bump(3, 0.0, 0, 0, step_px=4), fps=5.0))
    shows(page, "n-contact", "none")


def test_a_broker_with_users_asks_for_one(page: Chrome, tmp_path: Path) -> None:
    users = {"eve": "right"}
    with (
        Broker(tmp_path, users=users) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port, "drawn", "eve", "right") as sensor,
    ):
        page.get(address)
        shows(page, "login", "requires a user and password")
        for name, word in (("eve", "wrong"), ("eve", "right")):
            field = page.find_element(By.NAME, "username")
            field.clear()
            field.send_keys(name)
            page.find_element(By.NAME, "password").send_keys(word)
            page.find_element(By.CSS_SELECTOR, "#login button").click()
            shows(
                page,
                "link" if word == "right" else "login-why",
                "Connected" if word == "right" else "rejected",
            )
        assert not page.find_element(By.ID, "login").is_displayed()
        until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        page.refresh()  # kept for this tab
        shows(page, "link", "Connected")
        js(page, "sessionStorage.clear()")


def test_a_page_that_is_opened_to_a_network_wants_its_token_and_only_looks(tmp_path: Path) -> None:
    words = ["--host", "0.0.0.0", "--token-file", str(tmp_path / "token")]
    words += [
        f"--{name}={path}"
        for name, path in zip(("certificate", "key"), certificate(tmp_path), strict=True)
    ]
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", *words) as printed,
        PublishedSensor(broker.port) as sensor,
        Subscriber(broker.port, "tacshade/+/req/+") as seen,
        browser(tmp_path / "chromium", "--ignore-certificate-errors") as page,
    ):
        address, _, token = re.sub(r"//[^:]+", "//127.0.0.1", printed).partition("login#")
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
        until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        shows(page, "read-only", "Read-only")
        wait_until(lambda: js(page, "tacshade.sensor"), 10, "the sensor")
        assert not page.find_element(By.ID, "rezero").is_enabled()
        assert not page.find_element(By.ID, "profile").is_enabled()
        until_shown(page, sensor, lambda: bump(2, 0.0, 200, 300, step_px=4), 2)
        # In one go: the page disables it again with the next message.
        page.execute_script(
            "const it = document.getElementById('rezero'); it.disabled = false; it.click()"
        )
        shows(page, "link", "read-only: this dashboard forwards no requests")
        shows(page, "link", "Connected")
        assert seen.messages == []
        assert errors(page) == []
        picture(page, "login-read-only", (760, 900), "control")


def test_without_webgl_the_rest_goes_on(tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
        browser(tmp_path / "chromium", "--disable-3d-apis") as page,
    ):
        opened(page, address)
        until_shown(page, sensor, lambda: bump(1, 1.5, 200, 300), 1)
        assert "does not support WebGL" in text(page, "view")
        assert js(page, "tacshade.drawnPeak()") == pytest.approx(1.5, abs=0.01)
        assert errors(page) == []


@pytest.mark.parametrize("kept", ["[broken", "7", "null", '{"a": 1}'])
def test_a_damaged_store_and_a_bad_address_are_survived(
    page: Chrome, address: str, sensor: PublishedSensor, kept: str
) -> None:
    opened(page, address)
    page.execute_script("localStorage.setItem('tacshade-removed', arguments[0])", kept)
    page.execute_script("localStorage.setItem('tacshade-range', arguments[0])", kept)
    page.get("about:blank")
    opened(page, address, "100%")
    shows(page, "sensors", "drawn")
    page.execute_script("localStorage.clear()")


def test_a_browser_that_keeps_nothing_shows_the_sensors(
    tmp_path: Path, address: str, sensor: PublishedSensor
) -> None:
    blocked = {"profile.default_content_setting_values.cookies": 2}
    with browser(tmp_path / "profile", prefs=blocked) as page:
        opened(page, address)
        shows(page, "sensors", "drawn")
        assert page.execute_script(
            "try { localStorage.length; return false; } catch { return true; }"
        )
        assert errors(page) == []
