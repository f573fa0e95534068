"""Figures that the documents quote are those of their page of docs/results.

A claim is a sentence or table line, made from a page's figures (tests/support/figures), that must stand in its document
word for word. After a page was made again, a failure shows the line as it has to read.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest
from support.figures import accuracy, cost, readme, reliability, robots
from support.result_page import ROOT, Claims, flat


@cache
def document(path: str) -> str:
    return flat((ROOT / path).read_text(encoding="utf-8"))


CLAIMS = (*readme.CLAIMS, *accuracy.CLAIMS, *cost.CLAIMS, *robots.CLAIMS, *reliability.CLAIMS)


@pytest.mark.parametrize(("path", "claims"), CLAIMS)
def test_what_a_document_quotes_is_what_its_page_says(path: str, claims: Callable[[], Claims]) -> None:
    made = [flat(claim) for claim in claims()]
    assert made
    assert [claim for claim in made if claim not in document(path)] == [], path
