from __future__ import annotations

from http import HTTPStatus

import pytest

from tacshade_edge.dashboard.login import PERIOD_S, WRONG_MAX, Login, offered

TOKEN = "a-token-of-this-test"
WRONG, TOO_MANY = HTTPStatus.UNAUTHORIZED, HTTPStatus.TOO_MANY_REQUESTS


@pytest.fixture
def login() -> Login:
    return Login(TOKEN, "tacshade-80", secure=True)


@pytest.mark.parametrize(
    ("header", "token"),
    [(None, None), ("", None), ("Bearer", ""), ("Bearer abc", "abc"), ("bearer abc", "abc"), ("Basic dTpw", None)],
)
def test_what_a_header_tells(header: str | None, token: str | None) -> None:
    assert offered(header) == token


@pytest.mark.parametrize(
    ("cookies", "token"),
    [
        (None, None),
        ("", None),
        (";;=;", None),
        ("tacshade-80=abc", "abc"),
        ("a=b;tacshade-80=abc; tacshade-81=x", "abc"),
        ("tacshade-8=abc; xtacshade-80=abc", None),
        ("tacshade-80=a=b", "a=b"),
    ],
)
def test_what_a_browser_kept(cookies: str | None, token: str | None, login: Login) -> None:
    assert login.kept(cookies) == token


def test_the_token_passes_and_nothing_like_it(login: Login) -> None:
    assert login.refusal(TOKEN, "a", 0.0) is None
    for wrong in ("", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "é", "\udc80"):
        assert login.refusal(wrong, wrong, 0.0) is WRONG
    assert login.refusal(None, "a", 0.0) is WRONG
    assert login.wrong == 6


def test_an_address_that_guesses_waits_and_others_do_not(login: Login) -> None:
    for k in range(WRONG_MAX):
        assert login.refusal(f"{k}", "guesser", float(k)) is WRONG
    assert login.refusal(TOKEN, "guesser", PERIOD_S) is TOO_MANY
    assert login.refusal(TOKEN, "friend", PERIOD_S) is None
    assert login.refusal(TOKEN, "guesser", PERIOD_S + 1) is None
    assert login.wrong == WRONG_MAX


def test_the_same_wrong_token_again_is_no_new_try(login: Login) -> None:
    """A page that was open when the token changed, and then its user, who logs in."""
    assert {login.refusal("of yesterday", "a", k / 2) for k in range(100)} == {WRONG}
    assert login.wrong == 1
    assert login.refusal(TOKEN, "a", 50.0) is None


def test_so_many_addresses_are_remembered_and_no_more(login: Login) -> None:
    for k in range(10_000):
        login.refusal("wrong", f"address {k}", 0.0)
    assert len(login._tries) <= 256
