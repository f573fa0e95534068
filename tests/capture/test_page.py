from __future__ import annotations

import contextlib
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Iterator

import pytest

from tacshade_edge.capture.page import Chosen, Page, Shown
from tacshade_edge.types import Disc
from tools.testbed.patience import patience


@pytest.fixture
def page() -> Iterator[Page]:
    served = Page()
    yield served
    served.close()


def read(page: Page, path: str, **headers: str) -> tuple[bytes, str]:
    request = urllib.request.Request(page.address + path, headers=headers)
    with contextlib.closing(urllib.request.urlopen(request, timeout=patience(5))) as answer:
        return answer.read(), answer.headers["Content-Type"]


def test_it_shows_what_there_is_now(page: Page) -> None:
    assert b"<img" in read(page, "")[0]
    with pytest.raises(urllib.error.HTTPError) as none:
        read(page, "picture.jpg")
    none.value.close()
    page.shown = Shown(b"jpeg", "focus 0.3")
    assert read(page, "picture.jpg") == (b"jpeg", "image/jpeg")
    assert read(page, "text")[0] == b"focus 0.3"


def test_a_site_that_took_this_machines_address_for_its_name_gets_nothing(page: Page) -> None:
    page.shown = Shown(b"jpeg", "focus 0.3")
    assert read(page, "text", Host="localhost:9999")[0] == b"focus 0.3"
    with pytest.raises(urllib.error.HTTPError) as refused:
        read(page, "picture.jpg", Host="evil.example.org:8081")
    assert refused.value.code == 403
    refused.value.close()


def test_a_second_one_takes_another_port(page: Page) -> None:
    other = Page()
    assert other.address != page.address
    other.close()


RIM = b'{"points": [[140, 320], [240, 420], [340, 320]]}'


def post(page: Page, body: bytes, path: str = "circle", **headers: str) -> tuple[int, str]:
    reported = {"Origin": page.address.rstrip("/")} | headers
    request = urllib.request.Request(page.address + path, data=body, headers=reported, method="POST")
    try:
        with contextlib.closing(urllib.request.urlopen(request, timeout=patience(5))) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with contextlib.closing(error):
            return error.code, error.read().decode()


def test_three_points_are_a_circle_and_null_is_the_one_that_is_found(page: Page) -> None:
    page.shown = Shown(b"jpeg", "", (480, 640))
    assert post(page, RIM) == (200, "using your three points")
    assert page.chosen == deque([Chosen(Disc(240.0, 320.0, 100.0))])
    assert post(page, b'{"points": null}') == (200, "using the circle found in the picture again")
    assert page.chosen == deque([Chosen(None)])  # the newest alone


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b"", "circle: Input data was truncated"),
        (b"[]", "circle: Expected `object`, got `array`"),
        (b"{}", "circle: Object missing required field `points`"),
        (b'{"points": null, "radius": 3}', "circle: Object contains unknown field `radius`"),
        (b'{"points": [[1, 2], [3, 4]]}', "circle: Expected `array` of length 3"),
        (b'{"points": [[1, 2], [3, 4], [5, 6, 7]]}', "circle: Expected `array` of length 2"),
        (b'{"points": [[1, 2], [3, 4], [5, "6"]]}', "circle: Expected `float`, got `str`"),
        (b'{"points": [[1, 2], [3, 4], [5, NaN]]}', "circle: JSON is malformed"),
        (b'{"points": [[1, 2], [3, 4], [5, 1e300]]}', "circle: Expected `float` <= 20000"),
        (b'{"points": [[1, 2], [3, 4], [-2, 1]]}', "circle: Expected `float` >= -1"),
        (b'{"points": [[1, 2], [2, 4], [3, 6]]}', "three points: found points on one line"),
        (
            b'{"points": [[1, 2], [2, 4], [3, 641]]}',
            "three points: found a point at row 3, col 641, expected a point in",
        ),
        (b"\xff" * 9, "circle: JSON is malformed"),
    ],
)
def test_what_is_no_circle_is_one_line_and_changes_nothing(page: Page, body: bytes, said: str) -> None:
    page.shown = Shown(b"jpeg", "", (480, 640))
    status, answer = post(page, body)
    assert (status, answer.count("\n")) == (400, 0)
    assert answer.startswith(said)
    assert not page.chosen


def test_a_circle_is_taken_from_this_page_alone(page: Page) -> None:
    page.shown = Shown(b"jpeg", "", (480, 640))
    assert post(page, RIM, Origin="https://evil.example.org")[0] == 403
    assert post(page, RIM, Origin="http://evil.example.org", Host="evil.example.org")[0] == 403
    assert post(page, RIM, "text")[0] == 404
    assert post(page, RIM + b" " * 600)[0] == 413
    assert not page.chosen
