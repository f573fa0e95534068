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


def cookie(login: Login) -> str | None:
    return login.kept(login.set_cookie().partition(";")[0])


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
    assert login.refusal(TOKEN, None, "a", 0.0) is None
    for wrong in ("", TOKEN[:-1], TOKEN + "x", TOKEN.upper(), "é", "\udc80"):
        assert login.refusal(wrong, None, wrong, 0.0) is WRONG
    assert login.refusal(None, None, "a", 0.0) is WRONG
    assert login.wrong == 6


def test_an_address_that_guesses_waits_and_others_do_not(login: Login) -> None:
    for k in range(WRONG_MAX):
        assert login.refusal(f"{k}", None, "guesser", float(k)) is WRONG
    assert login.refusal(TOKEN, None, "guesser", PERIOD_S) is TOO_MANY
    assert login.refusal(TOKEN, None, "friend", PERIOD_S) is None
    assert login.refusal(TOKEN, None, "guesser", PERIOD_S + 1) is None
    assert login.wrong == WRONG_MAX


@pytest.mark.parametrize("as_cookie", [False, True])
def test_who_guesses_locks_out_no_browser_that_is_logged_in(login: Login, as_cookie: bool) -> None:
    mine, fresh = cookie(login), cookie(login)
    assert login.refusal(None, mine, "shared", 0.0) is None
    for k in range(2 * WRONG_MAX):
        guess = f"guess-{k}.x{k}"
        login.refusal(*((None, guess) if as_cookie else (guess, None)), "shared", 1.0)
    assert login.refusal(None, mine, "shared", 2.0) is None
    assert login.refusal(None, fresh, "shared", 2.0) is TOO_MANY  # a guess would look like this
    assert login.refusal(None, f"{str(mine)[:-1]}x", "shared", 2.0) is WRONG
    assert login.refusal(None, cookie(Login("another-token-of-us", "tacshade-80", secure=True)), "a", 2.0) is WRONG


def test_so_many_browsers_are_remembered_and_no_more(login: Login) -> None:
    for _ in range(300):
        assert login.refusal(None, cookie(login), "a", 0.0) is None
    assert len(login._browsers) <= 256


def test_the_same_wrong_token_again_is_no_new_try(login: Login) -> None:
    """A page that was open when the token changed, and then its user, who logs in."""
    assert {login.refusal("of yesterday", None, "a", k / 2) for k in range(100)} == {WRONG}
    assert login.wrong == 1
    assert login.refusal(TOKEN, None, "a", 50.0) is None


def test_so_many_addresses_are_remembered_and_no_more(login: Login) -> None:
    for k in range(10_000):
        login.refusal("wrong", None, f"address {k}", 0.0)
    assert len(login._tries) <= 256
