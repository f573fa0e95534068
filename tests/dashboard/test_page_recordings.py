"""The list of recordings in the page: played, downloaded, deleted,
and one clear line where that fails.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By
from selenium.webdriver.support.select import Select

from support.browser import errors
from support.cutting_proxy import cutting_proxy
from support.dashboard_process import dashboard
from support.mqtt_rig import Broker, Subscriber
from support.painted_sensor import FREE, TOUCHED, painted_calibration
from support.patience import patience, wait_until
from support.recordings import recorded, write_recording
from support.shown_page import NEEDS_A_BROWSER, js, opened, picture, shows, text
from tacshade_edge.calibration.files import calibration_file
from tacshade_edge.dashboard.recording_tar import tar_of

pytestmark = NEEDS_A_BROWSER


SAVED = """const make = URL.createObjectURL;
URL.createObjectURL = (blob) => { window.saved = blob; return make(blob); };
HTMLAnchorElement.prototype.click = function () { window.savedAs = this.download; };"""


def press(page: Chrome, words: str, name: str) -> None:
    """A button of one recording; the list is drawn anew meanwhile, so in one step."""
    button = (
        f"document.querySelector('#recordings button[aria-label=\"{words} "
        f"{name}\"]:not(:disabled)')"
    )
    wait_until(lambda: js(page, f"{button} !== null"), 15, f"{words} {name}")
    page.execute_script(f"{button}.click()")


def assert_saved(page: Chrome, path: Path) -> None:
    """What the page saved is the recording's tar."""
    digest = page.execute_async_script(
        "const done = arguments[0]; saved.arrayBuffer().then((all) => "
        "crypto.subtle.digest('SHA-256', all)).then((found) => done([...new "
        "Uint8Array(found)]));"
    )
    assert bytes(digest) == hashlib.sha256(b"".join(tar_of(path).pieces())).digest()


def names(page: Chrome) -> list[str]:
    return list(
        js(page, "[...document.querySelectorAll('#recordings-list b')].map((b) => b.textContent)")
    )


def test_a_recording_is_downloaded_and_deleted(page: Chrome, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    path = recorded(folder, "press-1")
    recorded(folder, "left-thumb/press-2", 1)
    (path / "more.bin").write_bytes(bytes(range(256)) * 78_125)
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", "--recordings", str(folder)) as address,
    ):
        opened(page, address)
        wait_until(
            lambda: names(page) == ["press-1", "left-thumb/press-2"], 15, "both, the newest first"
        )
        shows(page, "recordings-list", "1 frame · 0.0 MB")
        page.execute_script(SAVED)  # the driver waits for ever after a download that the page began
        press(page, "Download", "press-1")
        shows(page, "recordings-words", "downloaded press-1, 20.0 MB")
        assert js(page, "savedAs") == "press-1.tar"
        assert_saved(page, path)

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
        (missing,) = errors(page)  # the browser's own line about the answer
        assert "press-2.tar - Failed to load resource" in missing


@pytest.mark.parametrize("is_changed", [False, True])
def test_a_download_goes_on_where_its_connection_was_cut(
    page: Chrome, tmp_path: Path, is_changed: bool
) -> None:
    folder = tmp_path / "recordings"
    path = recorded(folder, "press-1")
    (path / "more.bin").write_bytes(os.urandom(8 << 20))
    cuts = (3 << 20, 1 << 20, 200)
    where = "/recordings/press-1.tar"
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", "--recordings", str(folder)) as address,
        cutting_proxy(int(address.rstrip("/").rpartition(":")[2]), where, cuts) as (port, proxy),
    ):
        opened(page, f"http://127.0.0.1:{port}/")
        page.execute_script(SAVED)
        press(page, "Download", "press-1")
        shows(page, "recordings-words", "the connection was lost, trying again")
        if is_changed:
            (path / "more.bin").write_bytes(os.urandom(2 << 20))
        shows(page, "recordings-words", "downloaded press-1", 30)
        assert_saved(page, path)
    assert len(proxy.requests) == len(cuts) + 1
    assert "Range" not in proxy.requests[0]
    tags = {request.partition("If-Range: ")[2].split("\r\n")[0] for request in proxy.requests[1:]}
    assert "" not in tags
    assert is_changed or tags == {tar_of(path).etag}
    # The browser's own lines about what was cut.
    assert all("press-1.tar - Failed to load resource" in line for line in errors(page))


def test_a_recording_is_played_and_ended_from_the_list(page: Chrome, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    # Half a minute: a busy machine takes some seconds to draw its first picture.
    path = write_recording(folder / "press-1", [FREE] * 3 + [TOUCHED] * 300, 100_000_000)
    calibration_file.save(path / "calibration.npz", painted_calibration())
    (path / "recording.json").write_text(json.dumps({"frames": 303, "bytes": 9_000_000}))
    recorded(folder, "broken", 1)  # without a calibration of its own
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}", "--recordings", str(folder)) as address,
    ):
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


PERIOD_NS = 33_000_000


def test_a_recording_is_paused_stepped_wound_and_played_again(page: Chrome, tmp_path: Path) -> None:
    def control(name: str) -> str:
        return f"document.getElementById('playback').elements.{name}"

    def press(name: str) -> None:
        wait_until(lambda: js(page, f"!{control(name)}.disabled"), 15, f"{name} can be pressed")
        page.find_element(By.NAME, name).click()

    def wind(to_s: float) -> None:
        slider = control("position")
        wait_until(lambda: js(page, f"!{slider}.disabled"), 15, "it can be wound")
        page.execute_script(f"{slider}.value = {to_s}; {slider}.dispatchEvent(new Event('change'))")

    def is_in_step() -> bool:
        mine, others, *_ = text(page, "compare-numbers").partition("frame ")[2].split()
        return mine == others

    calibration_file.save(tmp_path / "cal.npz", painted_calibration())
    write_recording(tmp_path / "rec", [FREE] * 5 + [TOUCHED] * 290 + [FREE] * 5, PERIOD_NS)
    command = [sys.executable, "-m", "tacshade_edge", "replay", str(tmp_path / "rec"), "--play"]
    command += ["--calibration", str(tmp_path / "cal.npz")]
    with (
        Broker(tmp_path) as broker,
        dashboard(f"127.0.0.1:{broker.port}") as address,
        Subscriber(broker.port, "tacshade/run-a/+/+") as seen,
    ):
        # Slowly, so that none ends before a slow browser has chosen both.
        command += ["--mqtt", f"127.0.0.1:{broker.port}", "--speed", "0.25"]
        child, other = (
            subprocess.Popen(
                [*command, "--sensor-id", name, "--profile", profile], stdout=subprocess.DEVNULL
            )
            for name, profile in (("run-a", "balanced"), ("run-b", "fast"))
        )
        try:
            opened(page, address, "run-a")
            wait_until(
                lambda: len(Select(page.find_element(By.ID, "against")).options) == 3,
                15,
                "there is another",
            )
            Select(page.find_element(By.ID, "against")).select_by_value("run-b")
            shows(page, "compare-numbers", "profile balanced fast")
            shows(page, "playback", " of 9.87 s")
            press("play")
            wait_until(lambda: js(page, f"{control('play')}.textContent") == "Play", 15, "paused")
            assert not page.find_element(By.ID, "rezero").is_enabled()
            wait_until(is_in_step, 15, "the other is paused at the same frame")
            wind(3.0)
            wait_until(lambda: js(page, "tacshade.seq") == 91, 15, "the first frame from 3.0 s on")
            shows(page, "playback", "frame 91")
            press("step")
            wait_until(lambda: js(page, "tacshade.seq") == 92, 15, "the next frame")
            wait_until(lambda: js(page, "tacshade.seq") == 92 and is_in_step(), 15, "of both")
            press("back")
            wait_until(
                lambda: js(page, "tacshade.seq") == 91 and is_in_step(),
                15,
                "the frame before, of both",
            )
            picture(page, "dashboard-compare", (1280, 640), "compare")
            wind(1.0)
            wait_until(lambda: js(page, "tacshade.seq") == 31, 15, "an earlier frame")
            shows(page, "playback", "1.02 s of 9.87 s, frame 31")
            picture(page, "dashboard-playback", (760, 420), "control")
            assert js(page, "document.getElementById('stale').hidden")  # it is paused, not late
            Select(
                page.find_element(By.CSS_SELECTOR, "#playback [name=speed]")
            ).select_by_visible_text("4 ×")
            wait_until(
                lambda: b'"speed":4' in seen.of("tacshade/run-a/status/replay")[-1], 15, "faster"
            )
            press("play")
            wait_until(lambda: js(page, "tacshade.seq") > 100, 15, "it goes on")
            child.send_signal(signal.SIGINT)
            assert child.wait(patience(20)) == 0
        finally:
            for process in (child, other):
                process.kill()
                process.wait()
        wait_until(
            lambda: not page.find_element(By.ID, "playback").is_displayed(), 15, "nothing to play"
        )
        assert all(b'"ok":true' in reply for reply in seen.of("tacshade/run-a/res/replay"))
