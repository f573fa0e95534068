from __future__ import annotations

import contextlib
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

from support.patience import patience
from tacshade_edge.capture.page import Page, Shown


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
