"""How the page is drawn: nothing empty, nothing that jumps, one screen for what matters on a phone."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from support.browser import browser, errors
from support.dashboard_process import dashboard
from support.published_sensor import DISC, PublishedSensor, bump, dragged, uncertain
from support.shown_page import NEEDS_A_BROWSER, js, opened, shows, text, unfold_health, until_shown

from tacshade_edge.protocol import json_payload, messages, wire
from tools.testbed.mqtt_rig import Broker
from tools.testbed.patience import wait_until

pytestmark = NEEDS_A_BROWSER

HEALTH = {
    "wall_ns": 1700000000000000000,
    "uptime_s": 7384.5,
    "frames": {"captured": 200, "published": 50, "without_contact": 149, "failed": 1, "invalid": 0},
    "delivered_fps": 29.96,
    "rss_bytes": 123456789,
    "latency_ms": {"p50": 12.25, "p99": 61.0},
    "stages_ms": {"depth": {"p50": 3.0, "p99": 9.0}, "touch": None},
    "invalid_reason": "",
    "invalid_reason_code": "",
    "degraded_reason_code": "",
    "budget": None,
    "reference": {"state": "waiting", "reason": "", "light": 0.98, "shift_px": None, "looks": 0, "moved_px": 0.25},
    "serial": {},
}


def boxes(page: Chrome, selector: str) -> list[list[float]]:
    """Left, top, right and bottom of each on the screen."""
    found: list[list[float]] = js(
        page,
        f"[...document.querySelectorAll('{selector}')].map((e) => e.getBoundingClientRect())"
        ".map((b) => [b.left, b.top, b.right, b.bottom])",
    )
    return found


def test_nothing_empty_is_shown_and_health_is_folded_and_in_a_persons_units(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
    ):

        def complaints() -> list[str]:
            words = str(js(page, "document.body.innerText"))
            empty = js(
                page,
                "[...document.querySelectorAll('main section, td, output, dd, figure, li')]"
                ".filter((e) => e.checkVisibility({ visibilityProperty: true }) && !e.innerText.trim()"
                " && !e.querySelector('canvas, img, i, svg')"
                " && !e.matches('form output')).map((e) => e.id || e.outerHTML.slice(0, 80))",
            )
            dashes = [line for line in words.splitlines() if re.fullmatch(r"[–-].{0,3}", line)]
            return [*empty, *dashes, *(bad for bad in ("null", "undefined", "NaN") if bad in words)]

        opened(page, address)
        shows(page, "state", "online")
        assert complaints() == []
        sensor.publish("health", json_payload.encode_json(HEALTH))
        shows(page, "health-words", "30.0 frames/s · 12 ms · 1 of 200 frames lost · up 2 h 3 min")
        assert not page.find_element(By.ID, "tables").is_displayed()
        until_shown(page, sensor, lambda: bump(7, 1.5, 200, 300, step_px=4), 7)
        assert complaints() == []
        unfold_health(page)
        sensor.publish("status/camera", messages.encode_status("streaming", None, {"device": "", "frame_us": 250}))
        shows(page, "tables", "memory 123.5 MB")
        shows(page, "tables", "with contact, sent 50 (25 %)")
        shows(page, "tables", "light 98 %")
        shows(page, "parts", "camera streaming frame 0.25 ms")
        for absent in ("shift", "budget", "Robot", "reason", "wall", "unusable"):
            assert absent not in text(page, "tables")
        assert complaints() == []
        until_shown(page, sensor, lambda: bump(8, 0.0, 200, 300, step_px=4), 8)
        assert complaints() == []


def test_tiles_and_maps_keep_their_place_whatever_the_numbers_are(page: Chrome, tmp_path: Path) -> None:
    selector = "#numbers dl > div, #map, #bar, #cursor, #chart, #space"

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
    ):
        opened(page, address)
        until_shown(page, sensor, lambda: bump(1, 0.0, 200, 300, step_px=4), 1)
        before = boxes(page, selector)
        shows(page, "n-contact", "none")
        sensor.publish("health", json_payload.encode_json(HEALTH))
        shows(page, "n-fps", "30.0")
        assert boxes(page, selector) == before
        until_shown(page, sensor, lambda: dragged(bump(2, 12.3, 200, 300, step_px=4), 2.0, 0.0), 2)
        shows(page, "n-depth", "12.30")
        assert text(page, "n-slip") == "sticks"
        many = {"contact": 1, "seq": 2, "depth_max_mm": 812.25, "area_mm2": 98765.4, "volume_mm3": 1234567.8}
        sensor.publish(
            "contact",
            json_payload.encode_json({**many, "objects": 64, "x_mm": -123.4, "y_mm": -987.6, "slip": 2, "fps": 1000}),
        )
        shows(page, "n-volume", "1234567.8")
        assert (text(page, "n-contact"), text(page, "n-slip")) == ("64 objects", "slides")
        assert boxes(page, selector) == before


def test_the_rim_is_round_ticks_are_round_and_cells_of_less_trust_are_marked(page: Chrome, tmp_path: Path) -> None:
    def clear_inside() -> Any:
        """Transparent pixels of the canvas whose middle lies inside the disc."""
        return js(
            page,
            "(() => { const c = window.cells, d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;"
            " let n = 0; for (let i = 0; i < c.height; i++) for (let j = 0; j < c.width; j++)"
            " if (Math.hypot(i - (c.height - 1) / 2, j - (c.width - 1) / 2) < c.width / 2 - 1"
            " && !d[4 * (i * c.width + j) + 3]) n++; return n; })()",
        )

    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
    ):
        opened(page, address)
        for seq, step_px in ((1, 2), (2, 8)):
            until_shown(
                page,
                sensor,
                lambda seq=seq, step_px=step_px: uncertain(bump(seq, 2.6, 200, 300, step_px), 1.0),
                seq,
            )
            assert clear_inside() == 0
            assert js(page, "getComputedStyle(window.cells).clipPath").startswith("ellipse(")
        ticks = js(page, "[...document.querySelectorAll('#ticks li')].map((t) => t.textContent)")
        assert ticks == ["0", "1", "2", "3 mm"]
        doubts = "document.getElementById('doubts').getAttribute('d').split('M').length - 1"
        wait_until(lambda: js(page, doubts) > 3, 15, "1.645 mm and more is deeper than parts of the touched bump")
        until_shown(page, sensor, lambda: bump(3, 0.0, 200, 300, 8), 3)
        wait_until(lambda: js(page, doubts) == 0, 15, "nothing touches")
        canvas = page.find_element(By.ID, "cells")
        canvas.send_keys("\ue014")  # arrow right: from the middle
        shows(page, "cursor", "0.000 mm")
        assert js(page, "document.activeElement.id") == "cells"


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_what_matters_on_one_screen(tmp_path: Path, scheme: str) -> None:
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
        feature = {"name": "prefers-color-scheme", "value": scheme}
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        opened(page, address)
        until_shown(page, sensor, lambda: dragged(bump(1, 2.4, DISC.row_c, DISC.col_c, 4), 1.0, 0.0), 1)
        shows(page, "n-slip", "sticks")
        for name in ("state", "n-contact", "n-depth", "n-slip", "cells", "bar", "ticks", "cursor"):
            ((left, top, right, bottom),) = boxes(page, f"#{name}")
            assert left >= 0 and top >= 0 and right <= width and bottom <= height, name  # noqa: PT018
            assert right > left and bottom > top, name  # noqa: PT018
        assert boxes(page, "#cells")[0][2] - boxes(page, "#cells")[0][0] > 300
        assert js(page, "document.documentElement.scrollWidth") <= width
        least = js(
            page,
            "Math.min(...[...document.querySelectorAll('main button, main select')]"
            ".filter((e) => e.checkVisibility()).map((e) => e.getBoundingClientRect().height))",
        )
        assert least >= 40, "a finger needs this much"
        assert errors(page) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_what_is_behind_them(page: Chrome, tmp_path: Path, scheme: str) -> None:
    """WCAG 2 AA: 4.5 to 1 for every colour of text on both backgrounds."""

    def luminance(name: str) -> float:
        page.execute_script(f"document.body.style.color = 'var(--{name})'")
        red, green, blue = js(page, "getComputedStyle(document.body).color.match(/[0-9.]+/g).slice(0, 3).map(Number)")
        parts = [
            v / 12.92 if v <= 0.04045 else ((v + 0.055) / 1.055) ** 2.4 for v in (red / 255, green / 255, blue / 255)
        ]
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]

    with Broker(tmp_path) as broker, dashboard(f"127.0.0.1:{broker.port}") as address:
        feature = {"name": "prefers-color-scheme", "value": scheme}
        page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        try:
            opened(page, address)
            behind = [luminance(name) for name in ("back", "card")]
            assert (max(behind) < 0.05) is (scheme == "dark")
            for name in ("text", "quiet", "accent", "good", "warn", "bad", "off"):
                for back in behind:
                    low, high = sorted((luminance(name), back))
                    assert (high + 0.05) / (low + 0.05) >= 4.5, name
        finally:
            page.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_a_damaged_map_leaves_the_marks_alone(page: Chrome, tmp_path: Path) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        PublishedSensor(broker.port) as sensor,
    ):
        opened(page, address)
        until_shown(page, sensor, lambda: uncertain(bump(7, 2.6, 200, 300, 4), 1.0), 7)
        other = uncertain(bump(7, 2.6, 200, 300, 8), 1.0)  # of the same frame, but another grid
        sensor.publish("sigma", wire.encode_sigma(other, calibration_crc32=1))
        wait_until(lambda: js(page, "document.getElementById('doubts').getAttribute('d')") == "", 15, "no marks")
        assert errors(page) == []
