"""The list of recordings in the page: played, downloaded, deleted, and one clear line where that fails."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from support.browser import errors
from support.dashboard_process import dashboard
from support.published_sensor import PublishedSensor
from support.recordings import recorded, write_recording
from support.shown_page import NEEDS_A_BROWSER, js, opened, picture, shows

from tacshade_edge.dashboard import recordings
from tacshade_edge.storage.calibration import calibration_file
from tools.testbed.mqtt_rig import Broker
from tools.testbed.painted_sensor import FREE, TOUCHED, painted_calibration
from tools.testbed.patience import wait_until

pytestmark = NEEDS_A_BROWSER


SAVED = """const make = URL.createObjectURL;
URL.createObjectURL = (blob) => { window.saved = blob; return make(blob); };
HTMLAnchorElement.prototype.click = function () { window.savedAs = this.download; };"""


def press(page: Chrome, words: str, name: str) -> None:
    """A button of one recording; the list is drawn anew meanwhile, so in one step."""
    button = f"document.querySelector('#recordings button[aria-label=\"{words} {name}\"]:not(:disabled)')"
    wait_until(lambda: js(page, f"{button} !== null"), 15, f"{words} {name}")
    page.execute_script(f"{button}.click()")


def names(page: Chrome) -> list[str]:
    return list(js(page, "[...document.querySelectorAll('#recordings-list b')].map((b) => b.textContent)"))


def test_a_recording_is_downloaded_and_deleted(page: Chrome, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    path = recorded(folder, "press-1")
    recorded(folder, "left-thumb/press-2", 1)
    (path / "more.bin").write_bytes(bytes(range(256)) * 78_125)
    with Broker(tmp_path) as broker, dashboard(f"127.0.0.1:{broker.port}", "--recordings", str(folder)) as address:
        opened(page, address)
        wait_until(lambda: names(page) == ["press-1", "left-thumb/press-2"], 15, "both, the newest first")
        shows(page, "recordings-list", "1 frames · 0.0 MB")
        page.execute_script(SAVED)  # the driver waits for ever after a download that the page began
        press(page, "Download", "press-1")
        shows(page, "recordings-words", "downloaded press-1, 20.0 MB")
        assert js(page, "savedAs") == "press-1.tar"
        digest = page.execute_async_script(
            "const done = arguments[0]; saved.arrayBuffer().then((all) => crypto.subtle.digest('SHA-256', all))"
            ".then((found) => done([...new Uint8Array(found)]));"
        )
        pieces: list[bytes] = []
        recordings.tar(path, pieces.append)
        assert bytes(digest) == hashlib.sha256(b"".join(pieces)).digest()

        press(page, "Delete", "press-1")
        page.switch_to.alert.dismiss()
        assert path.is_dir()
        press(page, "Delete", "press-1")
        assert "press-1" in page.switch_to.alert.text
        page.switch_to.alert.accept()
        shows(page, "recordings-words", "deleted press-1")
        wait_until(lambda: names(page) == ["left-thumb/press-2"], 15, "it is gone from the list")
        assert not path.exists()
        shutil.rmtree(folder / "left-thumb")
        press(page, "Download", "left-thumb/press-2")
        shows(page, "recordings-words", "found no recording left-thumb/press-2")
        assert page.find_element(By.ID, "recordings-words").get_attribute("data-level") == "bad"
        page.refresh()
        shows(page, "link", "Connected")
        assert not page.find_element(By.ID, "recordings").is_displayed()
        assert errors(page) == []


def test_a_recording_is_played_and_ended_from_the_list(page: Chrome, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    path = write_recording(folder / "press-1", [FREE] * 3 + [TOUCHED] * 300, 33_000_000)
    calibration_file.save(path / "calibration.npz", painted_calibration())
    (path / "recording.json").write_text(json.dumps({"frames": 303, "bytes": 9_000_000}))
    recorded(folder, "broken", 1)  # without a calibration of its own
    with Broker(tmp_path) as broker, dashboard(f"127.0.0.1:{broker.port}", "--recordings", str(folder)) as address:
        opened(page, address)
        press(page, "Play", "broken")
        shows(page, "recordings-words", "broken: ")
        shows(page, "recordings-words", "calibration.npz")
        press(page, "Play", "press-1")
        shows(page, "recordings-words", "playing press-1 as the sensor “recording”")
        wait_until(lambda: js(page, "tacshade.sensor") == "recording", 20, "it is shown")
        wait_until(lambda: js(page, "tacshade.drawn") > 3, 20, "it moves")
        picture(page, "dashboard-recordings", (1000, 560), "control")
        press(page, "End", "press-1")
        shows(page, "state", "stopped")
        shows(page, "recordings-words", "press-1 no longer plays")
        before = js(page, "tacshade.drawn")
        press(page, "Play", "press-1")
        wait_until(lambda: js(page, "tacshade.drawn") > before, 20, "again")
        page.get("about:blank")  # who leaves ends it
        page.get(address + "#recording")
        shows(page, "state", "stopped", 20)
        assert errors(page) == []


def test_without_a_folder_or_with_an_empty_one_no_list_is_shown(page: Chrome, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with Broker(tmp_path) as broker:
        for words in ((), ("--recordings", str(tmp_path / "empty"))):
            with dashboard(f"127.0.0.1:{broker.port}", *words) as address:
                opened(page, address)
                assert not page.find_element(By.ID, "recordings").is_displayed()
                page.get("about:blank")


def test_a_page_that_may_only_look_can_only_download(page: Chrome, tmp_path: Path) -> None:
    recorded(tmp_path / "recordings", "run")
    words = "--token-file", str(tmp_path / "token"), "--recordings", str(tmp_path / "recordings")
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", *words) as told,
        PublishedSensor(broker.port),
    ):
        page.get(told)
        wait_until(lambda: "login" not in page.current_url, 15, "logged in")
        wait_until(lambda: names(page) == ["run"], 15, "the list")
        able = js(page, "[...document.querySelectorAll('#recordings button:enabled')].map((b) => b.textContent)")
        assert able == ["Download"]
        page.execute_script(
            "const b = document.querySelector('[aria-label=\"Delete run\"]'); b.disabled = false;"
            "window.confirm = () => true; b.click()"
        )
        shows(page, "recordings-words", "read-only: this dashboard forwards no requests")
        assert (tmp_path / "recordings/run").is_dir()
