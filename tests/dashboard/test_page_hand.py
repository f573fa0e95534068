"""All fingers of a hand on one page."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path

import pytest
from selenium.webdriver import Chrome
from selenium.webdriver.common.by import By

from support.dashboard_process import dashboard
from support.mqtt_rig import Broker, Subscriber
from support.patience import wait_until
from support.published_sensor import PublishedSensor, bump
from support.shown_page import NEEDS_A_BROWSER, js, opened, picture, shows, text
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.types import Reconstruction
from tacshade_edge.wire.hand_messages import away, encode_hand
from tacshade_edge.wire.hand_topics import Finger, HandObject, HandObjects

pytestmark = NEEDS_A_BROWSER
ROW, COL = 250.0, 340.0
PLACES_MM = {
    "thumb": (-90, 0, 20),
    "index": (-46, 0, 90),
    "middle": (0, 0, 105),
    "ring": (46, 0, 95),
    "little": (90, 0, 70),
}
TOUCHED = HandObject(
    id=4,
    centroid_mm=(-79.0, -3.5, 34.25),
    extent_mm=(4.0, 4.0, 1.0),
    normal=(0.6, 0.0, 0.8),
    depth_max_mm=2.6,
    area_mm2=50.0,
    shear_mm=(0.3, 0.4, 0.0),
    twist_deg=0.0,
    slip=1,
    slip_mm_s=0.0,
)
FREE = Finger(state="free", t_ns=1, age_ms=20.0, seq=9)


class WholeHand:
    """Five fingers and their hand, without daemons."""

    def __init__(self, broker: Broker, stack: ExitStack) -> None:
        self.fingers = {
            name: stack.enter_context(PublishedSensor(broker.port, name)) for name in PLACES_MM
        }
        for name, finger in self.fingers.items():
            place = (*map(float, PLACES_MM[name]), 1.0, 0.0, 0.0, 0.0)
            finger.publish_info("fast", profiles=("fast",), hand_id="left", hand_T_sensor=place)
        self.own = stack.enter_context(Subscriber(broker.port, "tacshade/none"))
        self._seq = 0
        self.own.publish("tacshade/hand/left/state", b"online", retain=True)

    def publish(
        self,
        touching: Reconstruction | None,
        motion: dict[str, object] | None = None,
        **other: Finger,
    ) -> None:
        """One message of the hand, with a motion of all that is touched,
        and where the thumb touches its map.
        """
        thumb = (
            Finger(state="contact", t_ns=1, age_ms=3.0, seq=7, objects=(TOUCHED,))
            if touching
            else FREE
        )
        fingers = {**dict.fromkeys(PLACES_MM, FREE), "thumb": thumb, **other}
        self._seq += 1
        message = HandObjects(
            t_ns=time.monotonic_ns(), wall_ns=time.time_ns(), seq=self._seq, fingers=fingers
        )
        document = json.loads(encode_hand(message))
        for touched in chain.from_iterable(
            finger["objects"] for finger in document["fingers"].values()
        ):
            touched["motion"] = motion
        self.own.publish("tacshade/hand/left/objects", json.dumps(document).encode(), 0)
        if touching:
            self.fingers["thumb"].show(touching)


@pytest.fixture
def hand(tmp_path: Path) -> Iterator[tuple[str, WholeHand]]:
    """The page's address, and the hand."""
    with ExitStack() as stack:
        broker = stack.enter_context(Broker(tmp_path))
        address = stack.enter_context(dashboard(f"127.0.0.1:{broker.port}"))
        yield address, WholeHand(broker, stack)


PEAKS = """[...document.querySelectorAll("#whole-maps canvas")].map((canvas) => {
  const context = canvas.getContext("2d", { willReadFrequently: true });
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  let most = 0; // viridis: yellow is the deepest, its red is above 240
  for (let at = 0; at < data.length; at += 4) if (data[at + 3]) most = Math.max(most, data[at]);
  return most;
})"""


def test_every_finger_is_shown_and_what_it_touches_in_the_hands_frame(
    page: Chrome, hand: tuple[str, WholeHand]
) -> None:
    address, whole = hand
    opened(page, address, "hand/left")
    ring = away(Reason(ReasonCode.LOST, "gone"))

    def shown() -> bool:
        whole.publish(bump(7, 2.6, ROW, COL, 4), ring=ring)
        return bool(js(page, "tacshade.whole !== null")) and js(page, PEAKS)[0] > 150

    wait_until(shown, 20, "the thumb's map is drawn")
    peaks = js(page, PEAKS)
    assert len(peaks) == 5
    assert max(peaks[1:3]) < 80, "fingers that touch nothing are drawn flat"
    captions = [
        figure.text for figure in page.find_elements(By.CSS_SELECTOR, "#whole-maps figcaption")
    ]
    assert captions[0] == "thumb\n2.60 mm\nslips in part"
    assert captions[3] == "ring\naway: lost"
    assert text(page, "whole-state") == "left: online"
    shows(
        page, "whole-objects", "thumb -79.0, -3.5, 34.3 0.60, 0.00, 0.80 2.60 50 0.50 slips in part"
    )
    assert text(page, "whole-axes").startswith("x to the right, z upwards")
    (dot,) = page.find_elements(By.CSS_SELECTOR, "#whole-plane .touched")
    assert [float(dot.get_attribute(key) or "nan") for key in ("cx", "cy")] == [-79.0, -34.25]
    assert len(page.find_elements(By.CSS_SELECTOR, "#whole-plane .skin")) == 5
    assert not page.find_element(By.ID, "sensor").is_displayed()
    picture(page, "dashboard-hand", (1200, 1010))

    def released() -> bool:
        whole.publish(None)
        return bool(js(page, PEAKS)[0] < 80)

    wait_until(released, 20, "a release whose map was lost")


LIGHT = (
    """getComputedStyle(document.querySelector("#whole-maps figcaption .dot")).backgroundColor"""
)


def test_a_finger_that_is_touched_at_an_unknown_depth_has_a_light_of_its_own(
    page: Chrome, hand: tuple[str, WholeHand]
) -> None:
    address, whole = hand
    opened(page, address, "hand/left")
    lights = []
    for touched, says in ((False, "free"), (True, "touched, depth unknown")):
        thumb = replace(FREE, touched=touched)

        def said(thumb: Finger = thumb, says: str = says) -> bool:
            whole.publish(None, thumb=thumb)
            captions = page.find_elements(By.CSS_SELECTOR, "#whole-maps figcaption")
            return bool(captions) and captions[0].text == f"thumb\n{says}"

        wait_until(said, 20, says)
        lights.append(js(page, LIGHT))
        skins = page.find_elements(By.CSS_SELECTOR, "#whole-plane .unmeasured")
        assert len(skins) == touched
    assert lights[0] != lights[1]
    shows(page, "whole-objects", "touched, depth unknown")


def test_a_hand_is_not_called_old_before_its_first_word(
    page: Chrome, hand: tuple[str, WholeHand]
) -> None:
    opened(page, hand[0], "hand/right")
    shows(page, "whole-state", "No word from this hand yet.")


def moved_by(x_mm: float, turned_deg: float) -> dict[str, object]:
    """A motion as objects of a hand's message have it."""
    where = {
        "about_mm": [0, 0, 0],
        "translation_mm": [x_mm, 0, 0],
        "rotation_deg": [0, turned_deg, 0],
    }
    return {**where, "covariance": [0] * 36, "since_ns": 5, "unobservable": [], "left_out": []}


def test_what_is_held_is_drawn_as_one_body_that_moves(
    page: Chrome, hand: tuple[str, WholeHand]
) -> None:
    address, whole = hand
    opened(page, address, "hand/left")
    corners = {"thumb": (-80.0, 0.0, 0.0), "index": (0.0, 0.0, 60.0), "ring": (80.0, 0.0, 0.0)}

    def drawn(motion: dict[str, object] | None, at_mm: float) -> list[list[float]]:
        touched = {n: replace(TOUCHED, centroid_mm=p) for n, p in corners.items()}
        fingers = {
            n: Finger(state="contact", t_ns=1, age_ms=3.0, seq=7, objects=(o,))
            for n, o in touched.items()
        }
        whole.publish(None, **fingers, motion=motion)
        points = str(
            js(page, "document.querySelector('#whole-plane .body')?.getAttribute('points') ?? ''")
        )
        found = sorted([float(v) for v in corner.split(",")] for corner in points.split())
        return found if found and abs(found[0][0] - at_mm) < 0.01 else []

    wait_until(lambda: drawn(None, -80.0), 20, "patches without a motion are where they are")
    assert " mm" not in text(page, "whole-maps"), "no depth beside a map that has not arrived"
    # The body looks the same before: only its second outline shows
    # that the page has drawn a motion.
    held = "document.querySelector('#whole-plane .grasped') !== null"
    wait_until(lambda: drawn(moved_by(0, 0), -80.0) and js(page, held), 20, "grasped")
    assert js(
        page, "[...document.querySelectorAll('#whole-plane .name')].map((n) => n.textContent)"
    ) == [*PLACES_MM]
    wait_until(lambda: drawn(moved_by(4, 0), -76.0), 20, "it moves")
    assert list(chain(*drawn(moved_by(4, 0), -76.0))) == pytest.approx([-76, 0, 4, -60, 84, 0])
    assert "-80,0" in js(
        page, "document.querySelector('#whole-plane .grasped').getAttribute('points')"
    )
    turned = math.radians(10)
    wait_until(
        lambda: drawn(moved_by(0, 10), -80 * math.cos(turned)),
        20,
        "it is turned about the hand's y",
    )
    first = drawn(moved_by(0, 10), -80 * math.cos(turned))[0]
    assert first[1] == pytest.approx(-80 * math.sin(turned)), "what has x < 0 goes up"
    shows(page, "whole-axes", "since it was grasped moved by 0.0 mm, turned by 10.0°")
    picture(page, "dashboard-hand-moved", (1200, 1010))
