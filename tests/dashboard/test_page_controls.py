"""What a person commands, or takes away: recordings, marks, a zero that waits,
sensors that are gone.
"""

from __future__ import annotations

import json
from pathlib import Path

from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select

from support.dashboard_process import dashboard
from support.mqtt_rig import Broker, Subscriber
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
    until_shown,
)

pytestmark = NEEDS_A_BROWSER


def press(page: Chrome, name: str) -> None:
    button = page.find_element(By.NAME, name)
    wait_until(lambda: button.is_displayed() and button.is_enabled(), 15, f"{name} can be pressed")
    button.click()


def opacity(page: Chrome, element: str) -> float:
    return float(js(page, f"getComputedStyle(document.querySelector('{element}')).opacity"))


def test_a_recording_is_made_and_marked_and_a_daemon_that_died_is_shown_at_once(
    page: Chrome, tmp_path: Path, calibration: Path
) -> None:
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        daemon(tmp_path, calibration, broker.port) as child,
    ):
        opened(page, address)
        drawn(page)
        wait_until(lambda: opacity(page, ".rate") == opacity(page, "#numbers") == 1, 15, "live")

        Select(page.find_element(By.NAME, "seconds")).select_by_visible_text("10 min")
        press(page, "record")
        shows(page, "answer", "Recording to ")
        folder = Path(text(page, "answer").removeprefix("Recording to ").removesuffix("."))
        shows(page, "recording", "Recording ")
        shows(page, "recording", "of 10:00")
        page.find_element(By.NAME, "words").send_keys("it <b>slips</b>")
        press(page, "mark")
        shows(page, "answer", "Marked “it <b>slips</b>” after frame")
        wait_until(lambda: page.find_element(By.NAME, "mark").is_enabled(), 15, "the answer")
        picture(page, "dashboard-record", (760, 640), "control")
        press(page, "stop")
        shows(page, "answer", "Recorded ")
        events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
        assert [event["data"] for event in events if event["kind"] == "mark"] == [
            {"text": "it <b>slips</b>"}
        ]
        wait_until(
            lambda: page.find_element(By.NAME, "record").is_displayed(), 15, "another can be made"
        )
        assert not page.find_element(By.ID, "remove").is_displayed()

        shows(page, "n-fps", ".")  # no longer the start's
        child.kill()
        shows(page, "stale", "This sensor is offline: what you see is old, last updated ")
        page.get("about:blank")
        opened(page, address)
        shows(page, "state", "offline")
        shows(page, "n-fps", ".")  # retained: what was delivered once
        shows(page, "stale", "s ago.")
        assert max(opacity(page, name) for name in ("#numbers", "#tables", "#parts")) < 1
        assert js(page, "getComputedStyle(document.getElementById('n-fps')).fontWeight") == "400"
        picture(page, "dashboard-dead", (760, 560))

        page.find_element(By.ID, "remove").click()
        wait_until(
            lambda: not page.find_element(By.ID, "sensor").is_displayed(), 10, "the sensor is gone"
        )
        page.refresh()
        shows(page, "restore", "Show 1 removed")
        assert js(page, "document.querySelectorAll('#sensors button').length") == 0
        page.find_element(By.ID, "restore").click()
        shows(page, "state", "offline")
        page.find_element(By.ID, "remove").click()
        with daemon(tmp_path, calibration, broker.port):
            shows(page, "state", "online")  # it works again: nobody has to look for it


def test_a_new_zero_waits_until_nothing_touches(
    page: Chrome, address: str, sensor: PublishedSensor, seen: Subscriber
) -> None:
    def label() -> str:
        return text(page, "rezero")

    def asked(count: int, answer: dict[str, object]) -> None:
        def resting() -> bool:
            sensor.show(bump(100, 0.0, 200, 300, step_px=4))
            return len(seen.of("tacshade/drawn/req/reference")) == count

        wait_until(resting, 15, f"request {count}")
        body = json.loads(seen.of("tacshade/drawn/req/reference")[-1])
        sensor.publish(
            "res/reference", json.dumps({"transaction": body["transaction"], **answer}).encode()
        )

    opened(page, address)
    until_shown(page, sensor, lambda: bump(1, 2.0, 200, 300, step_px=4), 1)
    page.find_element(By.ID, "rezero").click()
    assert text(page, "answer") == "Re-zero waits until nothing touches the skin …"
    assert label() == "Cancel re-zero"
    picture(page, "rezero-waits", (760, 640), "control")
    page.find_element(By.ID, "rezero").click()
    assert (label(), text(page, "answer")) == ("Re-zero", "Cancelled: no new zero.")
    page.find_element(By.ID, "rezero").click()
    until_shown(page, sensor, lambda: bump(2, 2.0, 200, 300, step_px=4), 2)
    assert seen.messages == []
    asked(1, {"ok": False, "error": "touched", "reason_code": "frame_in_contact"})
    shows(page, "answer", "waits until nothing touches")  # touched meanwhile: the next rest
    asked(2, {"ok": True, "result": {"frames": 10}})
    shows(page, "answer", "Took a new zero from 10 frames.")

    until_shown(page, sensor, lambda: bump(3, 2.0, 200, 300, step_px=4), 3)
    page.find_element(By.ID, "rezero").click()
    sensor.publish("state", b"stopped", retain=True)  # nobody wants it when the sensor comes back
    shows(page, "answer", "Cancelled: no new zero.")
