"""The site's hook: links that leave docs/, anchors, folders in the list of pages."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from tools.release.docs_site import DOCS, expand, outside_links, pages_of, slug

PAGE = DOCS / "how-to" / "service.md"
FORGE = "https://forge.example/lab/tacshade-edge"


@pytest.mark.parametrize(
    ("link", "with_address", "without"),
    [
        ("[a](../../CHANGELOG.md)", f"[a]({FORGE}/blob/main/CHANGELOG.md)", "a"),
        ("[a](../../README.md#get-it)", f"[a]({FORGE}/blob/main/README.md#get-it)", "a"),
        ("[`a`](../../config)", f"[`a`]({FORGE}/tree/main/config)", "`a`"),
        ("[a](../decisions/)", f"[a]({FORGE}/tree/main/docs/decisions)", "a"),
    ],
)
def test_a_link_out_of_the_documents_leads_to_the_repository(link: str, with_address: str, without: str) -> None:
    assert outside_links(f"see {link}.", PAGE, FORGE) == f"see {with_address}."
    assert outside_links(f"see {link}.", PAGE, "") == f"see {without}."


@pytest.mark.parametrize(
    "link", ["[a](doctor.md#x)", "[a](#here)", "![a](../images/hand.webp)", "[a](https://example.org/a)", "[a](no.md)"]
)
def test_any_other_link_stays(link: str) -> None:
    assert outside_links(link, PAGE, FORGE) == link


def test_a_missing_file_outside_is_reported(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        outside_links("[a](../../NOWHERE.md)", PAGE, FORGE)
    assert "../../NOWHERE.md" in caplog.text


def test_an_anchor_is_the_forges() -> None:
    assert slug("`SENSOR.yaml`: what you know of the sensor") == "sensoryaml-what-you-know-of-the-sensor"


def test_a_folder_stands_for_its_pages(tmp_path: Path) -> None:
    for name in ("b", "a", "README"):
        (tmp_path / "results").mkdir(exist_ok=True)
        (tmp_path / "results" / f"{name}.md").touch()
    assert pages_of("results/", tmp_path) == ["results/README.md", "results/a.md", "results/b.md"]
    assert expand([{"Results": "results/"}, "index.md"], tmp_path) == [
        {"Results": ["results/README.md", "results/a.md", "results/b.md"]},
        "index.md",
    ]
