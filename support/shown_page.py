"""What the page's tests share: a daemon to show, and functions for what the browser shows."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from support.browser import CHROMIUM, DRIVER
from support.growing_map import GrowingMap
from support.mqtt_rig import MOSQUITTO
from support.patience import patience, wait_until
from support.published_sensor import PublishedSensor

_MISSING = [
    name
    for name, found in (("Chromium", CHROMIUM), ("its driver", DRIVER), ("mosquitto", MOSQUITTO))
    if not found
]
NEEDS_A_BROWSER = [
    pytest.mark.browser,
    pytest.mark.skipif(bool(_MISSING), reason=f"{', '.join(_MISSING)} not installed"),
]
PICTURES = os.environ.get("TACSHADE_SCREENSHOTS")
FPS = 10


@contextmanager
def daemon(
    folder: Path, calibration: Path, port: int, sensor_id: str = "left-index", fps: int = FPS
) -> Iterator[subprocess.Popen[bytes]]:
    """The real daemon on the simulated sensor; it must exit cleanly
    unless the caller has killed it.
    """
    config = folder / f"{sensor_id}.yaml"
    config.write_text(
        f"sensor_id: {sensor_id}\n"
        f"calibration: {calibration}\n"
        f"source: {{kind: simulated, fps: {fps}}}\n"
        f"mqtt: {{host: 127.0.0.1, port: {port}}}\n"
        f"recorder: {{folder: {folder / 'recordings'}}}\n"
    )
    command = [sys.executable, "-m", "tacshade_edge", "run", "--config", str(config)]
    child = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    try:
        yield child
        if child.poll() is None:
            child.send_signal(signal.SIGTERM)
            assert child.wait(patience(10)) == 0
    finally:
        child.kill()
        child.wait()


def js(page: Chrome, expression: str) -> Any:
    return page.execute_script(f"return {expression}")


def text(page: Chrome, element: str) -> str:
    return str(page.find_element(By.ID, element).text)


def shows(page: Chrome, element: str, part: str, timeout_s: float = 15) -> None:
    wait_until(lambda: part in text(page, element), timeout_s, f"{part!r} in #{element}")


def drawn(page: Chrome, timeout_s: float = 20) -> None:
    """Wait until one more map is on the screen."""
    before = js(page, "window.tacshade ? tacshade.drawn : 0")
    wait_until(
        lambda: js(page, "window.tacshade ? tacshade.drawn : 0") > before,
        timeout_s,
        "a map is drawn",
    )


def opened(page: Chrome, address: str, sensor_id: str = "") -> None:
    page.get(address + (f"#{sensor_id}" if sensor_id else ""))
    shows(page, "link", "Connected")


def unfold_health(page: Chrome) -> None:
    page.execute_script("document.getElementById('health').open = true")


def until_shown(page: Chrome, sensor: PublishedSensor, result: Callable[[], Any], seq: int) -> None:
    """Publish until the result is on the screen:
    QoS is 0, and the page may still be subscribing.
    """

    def again() -> bool:
        sensor.show(result())
        return bool(js(page, f"tacshade.seq === {seq}"))

    wait_until(again, 15, f"map {seq} on the screen")


def mapping(sensor: PublishedSensor, name: str, **corner_mm: float) -> GrowingMap:
    return GrowingMap(
        lambda topic, payload: sensor.publish(topic, payload, retain=True), name, **corner_mm
    )


def until_mapped(page: Chrome, name: str, revision: int) -> None:
    reported = "tacshade.stitched && [tacshade.stitched.name, tacshade.stitched.revision]"
    wait_until(
        lambda: js(page, reported) == [name, revision],
        15,
        f"revision {revision} of {name} on the screen",
    )


def picture(
    page: Chrome,
    name: str,
    size_px: tuple[int, int] | None = None,
    top: str = "",
    ready: Callable[[], bool] = lambda: True,
) -> None:
    if PICTURES is None:
        return
    before = page.get_window_size()
    if size_px is not None:
        page.set_window_size(*size_px)
        drawn_at = js(page, "performance.now()")
        wait_until(
            lambda: js(page, "performance.now()") > drawn_at + 1000, 10, "the new size is drawn"
        )
    if top:
        page.execute_script("document.getElementById(arguments[0]).scrollIntoView()", top)
    wait_until(ready, 60, f"what {name} shows")
    Path(PICTURES).mkdir(parents=True, exist_ok=True)
    page.save_screenshot(str(Path(PICTURES) / f"{name}.png"))
    page.set_window_size(before["width"], before["height"])
