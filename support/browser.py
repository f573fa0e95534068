"""Headless Chromium with Debian's own driver."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from selenium import webdriver
from selenium.webdriver.chrome.service import Service

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")

# No sandbox, since tests may run as root in a container; WebGL without a graphics card;
# nothing called outside.
_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--force-color-profile=srgb",
)


@contextmanager
def browser(
    profile: Path,
    *flags: str,
    size_px: tuple[int, int] = (1400, 1100),
    prefs: Mapping[str, object] | None = None,
) -> Iterator[webdriver.Chrome]:
    """A browser without history; `profile` is an empty folder for its files."""
    assert CHROMIUM is not None
    assert DRIVER is not None
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (
        *_FLAGS,
        f"--user-data-dir={profile}",
        f"--window-size={size_px[0]},{size_px[1]}",
        *flags,
    ):
        options.add_argument(flag)
    if prefs:
        options.add_experimental_option("prefs", dict(prefs))
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield driver
    finally:
        driver.quit()


def errors(driver: webdriver.Chrome) -> list[str]:
    """The page's errors and warnings since the last call,
    including those of the security policy.
    """
    reported = [
        f"{e['level']} {e['message']}"
        for e in driver.get_log("browser")
        if e["level"] in ("SEVERE", "WARNING")
    ]
    return [
        line for line in reported if "GL Driver Message" not in line
    ]  # a screenshot reads the software renderer back


def errors_of_the_page(driver: webdriver.Chrome) -> list[str]:
    """`errors` except the browser's own: it complains of each attempt to reach a server
    that has ended.
    """
    own = (
        "WebSocket is already in CLOSING or CLOSED state",
        "/favicon.svg - Failed to load resource",
        "ERR_CONNECTION_REFUSED",
    )
    return [line for line in errors(driver) if not any(text in line for text in own)]


def page(driver: webdriver.Chrome, expression: str) -> Any:
    """The value of a JavaScript expression in the page."""
    return driver.execute_script(f"return {expression}")
