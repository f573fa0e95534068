"""The page in a real browser while a client publishes messages meant to freeze it or crash its scripts."""

from __future__ import annotations

import contextlib
import json
import struct
import time
import zlib
from http.client import HTTPConnection
from urllib.parse import urlsplit

from selenium.webdriver import Chrome
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

from tacshade_edge.protocol import wire
from tools.faults.rig import Cell, Seen, SkippedError
from tools.testbed.browser import CHROMIUM, DRIVER, browser, errors, page
from tools.testbed.dashboard_process import dashboard
from tools.testbed.mqtt_rig import Subscriber
from tools.testbed.patience import stretched, wait_until
from tools.testbed.published_sensor import PublishedSensor, bump
from tools.testbed.shown_page import until_shown

LONG = "x y " * 50_000
TASKS = """
window.tasks = [];
new PerformanceObserver((seen) => { for (const task of seen.getEntries()) window.tasks.push(task.duration); })
  .observe({ entryTypes: ["longtask"] });
"""
PATHS = (
    "/../server.py",
    "/vendor/../../server.py",
    "/%2e%2e/server.py",
    "//etc/passwd",
    "/\\..\\server.py",
    "/vendor/",
)
ORIGINS = ("http://evil.example", "http://127.0.0.1:9", "http://localhost.evil.example", "null")
GUESSES = 30
TASK_S_MAX = 1.0
"""Longest time that the page may be unresponsive."""
GRIDS = ((0, 0, 4.0), (0, 7, 4.0), (5000, 1, 4.0), (4, 4, 0.0), (4, 4, float("nan")), (4, 4, 1e-30))
TEXTS: tuple[tuple[str, object], ...] = (
    ("status/camera", {"state": "away", "reason": LONG, "device": LONG}),
    ("health", {"invalid_reason": LONG, "degraded_reason": LONG}),
    ("health", {f"k{k}": k for k in range(20_000)}),
    ("health", {"stages_ms": {f"k{k}": {"p50": 1, "p99": 1} for k in range(20_000)}}),
    ("health", {"reason": "x" * (8 << 20)}),
    ("info", {"profiles": [f"p{k}" for k in range(20_000)], "profile": LONG}),
    ("info", {"profiles": 5}),
    ("info", {"geometry": {"radius_px": 0, "image_height_px": 1e9, "image_width_px": 1e9}}),
    ("contact", {"contact": 1, "depth_max_mm": LONG, "x_mm": {}}),
    ("touch", {"seq": 1, "touch": {f"k{k}": k for k in range(20_000)}, "touch_sigma": {}, "reason": LONG}),
    ("status/replay", {"state": "playing", "position_s": LONG, "speed": LONG}),
    ("status/stitching", {"state": "open", "name": LONG, "presses": {}}),
    (
        "map/revision",
        {"name": LONG, "revision": 1, "x0_mm": 1e308, "width_mm": 1e308, "spacing_mm": 1e-300},
    ),
)


def hostile_messages(cell: Cell) -> Seen:
    """Publish each of `TEXTS` and `GRIDS`, many parts and many sensors, next to a sound sensor."""
    if CHROMIUM is None or DRIVER is None:
        raise SkippedError("needs Chromium and its driver")
    cell.broker.start()
    port = cell.broker.port
    with (
        dashboard(f"127.0.0.1:{port}") as address,
        PublishedSensor(port) as sensor,
        Subscriber(port, "none") as other,
        browser(cell.folder / "chromium") as driver,
    ):
        driver.get(f"{address}#drawn")
        until_shown(driver, sensor, lambda: bump(1, 1.5, 200, 300, step_px=4), 1)
        driver.execute_script(TASKS)
        for topic, body in TEXTS:
            sensor.publish(topic, json.dumps(body).encode())
            drawn_again(driver)
        sound = wire.encode_height(bump(2, 2.0, 200, 300, step_px=4), calibration_crc32=1)
        for rows, cols, step_px in GRIDS:
            for topic in ("height", "shear", "sigma", "cloud"):
                sensor.publish(topic, grid_message(sound, rows, cols, step_px))
            drawn_again(driver)
        for number in range(1000):
            sensor.publish(f"status/p{number}", b'{"state": "x"}')
            other.publish(f"tacshade/invented{number}/state", b"online", 0)
        drawn_again(driver)
        longest_ms = max(page(driver, "window.tasks") or [0])  # the 3-D skin is slow without an accelerator
        since_s = time.monotonic()
        sensor.publish_info("fast", profiles=("fast",))
        until_shown(driver, sensor, lambda: bump(3, 1.0, 200, 300, step_px=4), 3)
        recovered_s = time.monotonic() - since_s
        counted = page(driver, "tacshade.undecodable")
        complaints = errors(driver)
    assert complaints == [], complaints
    assert counted >= len(GRIDS), counted
    assert longest_ms < 1000 * stretched(TASK_S_MAX), longest_ms
    return Seen(None, recovered_s, "nothing", f"page: {counted} not understood, longest task {longest_ms:.0f} ms")


def drawn_again(driver: Chrome) -> None:
    """Wait until the page has reported its health once more, which it does twice a second."""
    before_ms = page(driver, "performance.now()")
    wait_until(lambda: page(driver, "performance.now()") > before_ms + 1000, 60, "the page answers")


def grid_message(sound: bytes, rows: int, cols: int, step_px: float) -> bytes:
    """Make a `height` message with another grid and a right checksum."""
    payload = bytes(2 * rows * cols)
    head = bytearray(sound[:96])
    struct.pack_into("<HH", head, 32, rows, cols)
    struct.pack_into("<f", head, 44, step_px)
    struct.pack_into("<I", head, 84, len(payload))
    struct.pack_into("<I", head, 88, zlib.crc32(bytes(head[:88]) + payload))
    return bytes(head) + payload


def who_may_not(cell: Cell) -> Seen:
    """Try unknown paths, other sites' pages and guessed tokens, after the right token has opened the page."""
    cell.broker.start()
    token_file = cell.folder / "token"
    with dashboard(f"127.0.0.1:{cell.broker.port}", "--token-file", str(token_file)) as address:
        port = urlsplit(address).port
        assert port is not None
        token = token_file.read_text().strip()
        assert status_of(port, "/main.js", token) == 200
        asked = {
            (path, right): status_of(port, path, token if right else "") for path in PATHS for right in (True, False)
        }
        assert set(asked.values()) <= {401, 404}, asked
        bearer = {"Authorization": f"Bearer {token}"}
        for origin in ORIGINS:
            url = f"ws://127.0.0.1:{port}/mqtt"
            with contextlib.suppress(InvalidStatus), connect(url, origin=Origin(origin), additional_headers=bearer):
                raise AssertionError(f"{origin} was let in")
        guessed = [status_of(port, "/login", f"wrong{k}") for k in range(GUESSES)]
    assert set(guessed) == {401, 429}, guessed
    refused = f"{len(asked)} paths, {len(ORIGINS)} sites, {GUESSES} tokens ({guessed.count(429)} of them unseen)"
    return Seen(None, None, f"nothing; refused: {refused}", "log: wrong tokens and sites")


def status_of(port: int, path: str, token: str) -> int:
    """Request a verbatim path from the page's server and return the status code."""
    with contextlib.closing(HTTPConnection("127.0.0.1", port, timeout=30)) as connection:
        connection.request("GET", path, headers={"Authorization": f"Bearer {token}"} if token else {})
        return connection.getresponse().status


FAULTS = {
    "the page is asked for by who may not": who_may_not,
    "what is to freeze or end the page is published": hostile_messages,
}
