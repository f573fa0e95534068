"""The untouched sensor and unlabelled touches, as a person at a terminal
and a scripted camera take them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from support.painted_sensor import FREE
from tacshade_edge.calibration.files.capture_folder import CaptureFolder
from tacshade_edge.calibration.presses.press_check import Judgement
from tacshade_edge.calibration.reference.stillness import block_means
from tacshade_edge.capture import unlabelled
from tacshade_edge.capture.live import Live, Terminal
from tacshade_edge.capture.page import Page
from tacshade_edge.capture.unlabelled import TOUCHES, Unlabelled
from tacshade_edge.errors import DeviceError
from tacshade_edge.reasons import Reason, ReasonCode
from tacshade_edge.sensor.image.greyscale import to_grey
from tacshade_edge.types import U8, Disc, Frame

pytestmark = pytest.mark.slow
FPS = 20
Picture = Callable[[float], U8]


def touched(x_px: int) -> U8:
    """The skin with something bright at a place."""
    return np.asarray(cv2.circle(FREE.copy(), (x_px, 60), 10, 255, -1), np.uint8)


def shown(*parts: tuple[float, U8]) -> Picture:
    """Pictures one after the other, each for some seconds; the last one for ever."""

    def at(t_s: float) -> U8:
        for seconds, picture in parts:
            if t_s < seconds:
                return picture
            t_s -= seconds
        return parts[-1][1]

    return at


class Bench:
    """A person and a camera, on the camera's clock."""

    def __init__(self, folder: Path) -> None:
        self.folder = CaptureFolder(folder)
        self.picture: Picture = shown((0, FREE))
        self.t_ns, self.lost_s = 0, float("inf")
        self.types: dict[float, str] = {}
        self.texts: list[str] = []
        self.judgement = Judgement(None)
        self._line, self._typed = os.pipe()
        self._page = Page()
        self.said = (folder / "said").open("w+")
        terminal = Terminal(self._line, self.said)
        disc = Disc(59.5, 79.5, 50.0)
        self.live = Live(self, terminal, self._page, disc, rest_grey=1.0)  # type: ignore[arg-type]
        self.made = Unlabelled(self.folder, self.live, terminal, lambda _: self.judgement)

    def read(self) -> Frame:
        """The next frame, after what the person types meanwhile."""
        t_s = self.t_ns / 1e9
        for when_s in [each for each in self.types if each <= t_s]:
            os.write(self._typed, f"{self.types.pop(when_s)}\n".encode())
        if t_s >= self.lost_s:
            raise DeviceError("the camera is gone")
        frame = Frame(0, self.t_ns, 0, self.picture(t_s))
        self.t_ns += 1_000_000_000 // FPS
        self.texts.append(self._page.shown.text)
        return frame

    def run(self, part: Callable[[], object], *parts: tuple[float, U8], **types: str) -> str:
        """What is said while the person types Enter at once, then other lines at `at_SECONDS`."""
        self.t_ns, self.picture = 0, shown(*parts)
        self.types = {0.0: ""} | {
            float(at[3:].replace("_", ".")): line for at, line in types.items()
        }
        start = self.said.tell()
        part()
        self.said.seek(start)
        return self.said.read()

    def close(self) -> None:
        self._page.close()
        self.said.close()
        os.close(self._line)
        os.close(self._typed)


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(unlabelled, "REST_S", 3.0)
    monkeypatch.setattr(unlabelled, "REST_PICTURES", 30)
    monkeypatch.setattr("tacshade_edge.capture.live._PICTURE_S", 0.0)
    made = Bench(tmp_path)
    yield made
    made.close()


def test_rest_is_so_many_pictures_at_even_times(bench: Bench) -> None:
    said = bench.run(bench.made.take_rest, (0, FREE))
    names = [path.name for path in bench.folder.rest_pictures()]
    assert names == [f"rest_{k:03d}.png" for k in range(1, 31)]
    np.testing.assert_array_equal(bench.folder.picture(bench.folder.rest_pictures()[0]), FREE)
    assert "rest: 30 pictures of the untouched sensor in 3 s" in said
    assert "warning" not in said
    assert any("untouched sensor: 2 of 3 s" in text for text in bench.texts)


def test_rest_can_be_cut_short_but_not_too_short(bench: Bench) -> None:
    said = bench.run(bench.made.take_rest, (0, FREE), at_0_5="")
    assert "not kept: found 5 pictures, expected at least 20" in said
    assert bench.folder.rest_pictures() == []
    assert "rest: 25 pictures" in bench.run(bench.made.take_rest, (0, FREE), at_2_5="")


def test_an_interrupted_rest_leaves_the_earlier_one(bench: Bench) -> None:
    bench.run(bench.made.take_rest, (0, FREE))
    bench.lost_s = 2.0
    with pytest.raises(DeviceError, match="the camera is gone"):
        bench.run(bench.made.take_rest, (0, touched(50)))
    kept = bench.folder.rest_pictures()
    assert len(kept) == 30
    np.testing.assert_array_equal(bench.folder.picture(kept[0]), FREE)


def test_a_rest_that_looks_touched_is_kept_with_a_warning(bench: Bench) -> None:
    bench.judgement = Judgement(None, in_contact=True)
    said = bench.run(bench.made.take_rest, (0, FREE))
    assert "warning: 15 of 15 look as if something touched the skin" in said
    assert len(bench.folder.rest_pictures()) == 30


def test_a_touch_is_taken_once_it_stands_still_and_only_if_it_is_another_one(bench: Bench) -> None:
    moving = [(0.05, touched(x_px)) for x_px in range(60, 110, 5)]
    said = bench.run(
        bench.made.take_touches,
        (2, FREE),
        (2, touched(50)),
        (1, FREE),
        (2, touched(50)),
        (1, FREE),
        *moving,
        (2, touched(110)),
        (1, FREE),
        at_13="",
    )
    taken = [bench.folder.picture(path) for path in bench.folder.touch_pictures()]
    assert [path.name for path in bench.folder.touch_pictures()] == ["touch_01.png", "touch_02.png"]
    np.testing.assert_array_equal(taken, [touched(50), touched(110)])
    assert "2 unlabelled touches" in said
    told = {text.splitlines()[0] for text in bench.texts}
    assert {
        "touch 1 of 20: touch the skin",
        "touch 1 of 20: hold still",
        "touch 2 of 20: touch elsewhere",
        "touch 2 of 20: hold still",
    } <= told


def test_touches_go_on_where_they_ended_and_end_by_themselves(bench: Bench) -> None:
    for _ in range(TOUCHES - 1):
        bench.folder.add_touch(FREE)
    said = bench.run(
        bench.made.take_missing, (1.5, FREE), (9, touched(50)), at_0_1="skip", at_0_2=""
    )
    assert "20 unlabelled touches" in said
    assert bench.folder.touch_pictures()[-1].name == "touch_20.png"


def test_a_picture_that_calibrate_cannot_use_is_not_taken(bench: Bench) -> None:
    bench.judgement = Judgement(Reason(ReasonCode.TORN, "torn"))
    bench.run(bench.made.take_touches, (1.5, FREE), (2, touched(50)), at_3="")
    assert bench.folder.touch_pictures() == []
    assert any("touch 1 of 20: not taken: torn" in text for text in bench.texts)


def test_both_can_be_left_out_and_touches_be_taken_anew(bench: Bench) -> None:
    bench.folder.add_touch(touched(50))
    bench.types = {0.0: "skip", 0.1: "skip"}
    assert bench.made.take_missing() == ""
    bench.types = {0.0: "ball 6 2 0 0"}
    assert bench.made.take_missing() == "ball 6 2 0 0"
    assert (len(bench.folder.rest_pictures()), len(bench.folder.touch_pictures())) == (0, 1)
    bench.run(lambda: bench.made.take_touches(anew=True), (1.5, FREE), (2, touched(110)), at_3="")
    (only,) = bench.folder.touch_pictures()
    np.testing.assert_array_equal(bench.folder.picture(only), touched(110))


def test_a_smaller_change_than_at_rest_is_no_contact() -> None:
    from tacshade_edge.capture.change import ChangeFromRest

    rng = np.random.default_rng(1)
    noisy = [
        block_means(np.clip(to_grey(FREE) + rng.normal(0, 3, FREE.shape), 0, 255).astype(np.uint8))
        for _ in range(12)
    ]
    rest = ChangeFromRest(noisy[:10])
    assert not any(map(rest.in_contact, noisy))
    assert not rest.in_contact(noisy[0] + 20)  # a change of the light, which all share
    assert rest.in_contact(block_means(touched(50)))
