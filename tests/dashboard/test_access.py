"""Who may open the page and its WebSocket, and what it may do there; real sockets."""

from __future__ import annotations

import asyncio
from http import HTTPStatus

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from support.page_server import TOKEN, echo, get, running, tcp, websocket
from tacshade_edge.dashboard import page_files
from tacshade_edge.dashboard.access import PERIOD_S, WRONG_MAX, Login, refusal

WORD = "a-token-of-this-test"
WRONG, TOO_MANY = HTTPStatus.UNAUTHORIZED, HTTPStatus.TOO_MANY_REQUESTS


@pytest.mark.parametrize(
    ("origin", "host", "passes"),
    [
        ("http://127.0.0.1:8080", "127.0.0.1:8080", True),
        ("http://localhost:8080", "localhost:8080", True),
        ("http://[::1]:8080", "[::1]:8080", True),
        ("http://192.168.1.7:8080", "192.168.1.7:8080", True),
        ("https://hand.example", "hand.example", True),  # given with --origin
        ("https://hand.example", "127.0.0.1:8080", True),  # as many proxies ask
        (None, "127.0.0.1:8080", True),  # no browser
        ("http://evil.example", "127.0.0.1:8080", False),
        ("http://127.0.0.1:9999", "127.0.0.1:8080", False),  # another server on this machine
        ("http://evil.example:8080", "evil.example:8080", False),  # its name, our address
        ("http://localhost.evil.example", "localhost.evil.example", False),
        ("null", "127.0.0.1:8080", False),  # a file, a sandboxed frame
        ("http://127.0.0.1:8080", None, False),
        ("", "", False),
    ],
)
def test_who_may_open_the_websocket(origin: str | None, host: str | None, passes: bool) -> None:
    assert (refusal(origin, host, {"https://hand.example"}) == "") is passes


async def test_another_page_is_refused_before_any_byte_reaches_the_broker(
    caplog: pytest.LogCaptureFixture,
) -> None:
    connected = []

    async def count(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connected.append(1)
        writer.close()

    async with tcp(count) as broker, running(broker) as port:
        with pytest.raises(InvalidStatus) as refused:
            await websocket(port, origin="http://evil.example").__aenter__()
        assert refused.value.response.status_code == 403
        assert b"expected one from here" in (refused.value.response.body or b"")
        with pytest.raises(InvalidStatus):
            await websocket(port, origin="http://evil.example").__aenter__()
        assert (await get(port, "/mqtt"))[0] == 426
        assert connected == []
        async with websocket(port, origin=f"http://127.0.0.1:{port}") as page:
            with pytest.raises(ConnectionClosed):
                await page.recv()
        assert connected == [1]
    assert [r.getMessage().count("--origin http://evil.example") for r in caplog.records] == [
        1
    ]  # reported once


async def test_without_the_token_there_is_a_login_and_nothing_else() -> None:
    async with tcp(echo) as broker, running(broker, token=TOKEN) as port:
        for path in sorted(page_files.load()):
            status, headers, body = await get(port, path)
            if path in ("/", "/index.html"):
                assert (status, headers["location"], body) == (303, "login", b"")
            elif path in ("/login", "/login.js", "/style.css", "/favicon.svg"):
                assert status == 200
            else:
                assert (status, b"token" in body) == (401, True), path
        with pytest.raises(InvalidStatus) as refused:
            await websocket(port).__aenter__()
        assert refused.value.response.status_code == 401

        status, headers, _ = await get(port, "/login", f"Authorization: Bearer {TOKEN}")
        assert status == 204
        cookie, *flags = headers["set-cookie"].split("; ")
        assert {"HttpOnly", "SameSite=Strict", "Path=/"} < set(flags)
        assert "Secure" not in flags
        assert (await get(port, "/", f"Cookie: other=1; {cookie}"))[0] == 200
        assert (await get(port, "/main.js", f"Authorization: bearer {TOKEN}"))[0] == 200
        assert (await get(port, "/", f"Cookie: {cookie}", f"Cookie: {cookie}"))[0] == 400
        # a proxy's own login
        assert (await get(port, "/", f"Cookie: {cookie}", "Authorization: Basic dTpw"))[0] == 200
        async with websocket(port, additional_headers={"Cookie": cookie}) as page:
            await page.send(b"hello")
            assert await page.recv() == b"hello"


@pytest.fixture
def login() -> Login:
    return Login(WORD, "tacshade-80", secure=True)


def cookie(login: Login) -> str | None:
    return login.kept(login.set_cookie().partition(";")[0])


def test_the_token_passes_and_nothing_like_it(login: Login) -> None:
    assert login.refusal(WORD, None, "a", 0.0) is None
    for wrong in ("", WORD[:-1], WORD + "x", WORD.upper(), "é", "\udc80"):
        assert login.refusal(wrong, None, wrong, 0.0) is WRONG
    assert login.refusal(None, None, "a", 0.0) is WRONG
    assert login.wrong == 6


def test_an_address_that_guesses_is_told_to_wait(login: Login) -> None:
    for k in range(WRONG_MAX):
        assert login.refusal(f"{k}", None, "guesser", float(k)) is WRONG
    assert login.refusal("another", None, "guesser", PERIOD_S) is TOO_MANY
    assert login.refusal("another", None, "friend", PERIOD_S) is WRONG
    assert login.wrong == WRONG_MAX + 2  # also those that were told to wait
    assert login.refusal("another", None, "guesser", PERIOD_S + 1) is WRONG


@pytest.mark.parametrize("as_cookie", [False, True])
def test_who_guesses_locks_out_nobody_who_has_the_token(login: Login, as_cookie: bool) -> None:
    mine, restarted = cookie(login), cookie(Login(WORD, "tacshade-80", secure=True))
    for k in range(2 * WRONG_MAX):
        guess = f"guess-{k}.x{k}"
        login.refusal(*((None, guess) if as_cookie else (guess, None)), "shared", 1.0)
    assert login.refusal(WORD, None, "shared", 2.0) is None
    for right in (mine, restarted):
        assert login.refusal(None, right, "shared", 2.0) is None
    assert login.refusal("guess-0", None, "shared", 2.0) is TOO_MANY
    assert login.refusal(None, f"{str(mine)[:-1]}x", "shared", 2.0) is TOO_MANY
    other = cookie(Login("another-token-of-us", "tacshade-80", secure=True))
    assert login.refusal(None, other, "a", 2.0) is WRONG


async def test_the_right_token_opens_the_page_while_its_address_guesses() -> None:
    async with running(token=TOKEN) as port:
        for k in range(WRONG_MAX):
            assert (await get(port, "/main.js", f"Authorization: Bearer {k}"))[0] == 401
        assert (await get(port, "/main.js", "Authorization: Bearer another"))[0] == 429
        status, headers, _ = await get(port, "/login", f"Authorization: Bearer {TOKEN}")
        assert status == 204
        kept = headers["set-cookie"].partition(";")[0]
        assert (await get(port, "/main.js", f"Cookie: {kept}"))[0] == 200
        assert (await get(port, "/main.js", "Authorization: Bearer another"))[0] == 429


def test_so_many_addresses_are_remembered_and_no_more(login: Login) -> None:
    for k in range(300):
        for n in range(WRONG_MAX):
            login.refusal(f"wrong {n}", None, f"address {k}", 0.0)
    newest_first = [login.refusal("wrong", None, f"address {k}", 0.0) for k in range(299, -1, -1)]
    assert newest_first == [TOO_MANY] * 256 + [WRONG] * 44


def test_a_cookie_is_sent_from_a_frame_only_over_tls_and_where_one_may_be() -> None:
    flags = {
        (secure, framed): Login(WORD, "a", secure=secure, framed=framed).set_cookie()
        for secure in (False, True)
        for framed in (False, True)
    }
    assert flags.pop((True, True)).endswith("; SameSite=None; Secure; Partitioned")
    assert all("SameSite=Strict" in each for each in flags.values())
