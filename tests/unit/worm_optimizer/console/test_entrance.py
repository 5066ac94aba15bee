# SPDX-License-Identifier: Apache-2.0
"""The guard's own responses and the requests that it passes on, as ASGI messages."""

import asyncio
from typing import Any

import pytest

from worm_optimizer.console.access import Access
from worm_optimizer.console.entrance import Guard, IgnoreDisconnects

HOST = "robot:8080"


class Site:
    """The pages behind a guard, which record the requests that reach them."""

    def __init__(self, secret: str) -> None:
        self.reached: list[str] = []
        self.guard = Guard(self._pages, Access(secret, lambda: 0.0))

    async def _pages(self, scope: Any, receive: Any, send: Any) -> None:
        self.reached.append(scope["path"])
        await send({"type": "http.response.start", "status": 200, "headers": []})

    def request(
        self,
        path: str,
        *,
        kind: str = "http",
        method: str = "GET",
        query: str = "",
        body: str = "",
        **headers: str,
    ) -> list[dict[str, Any]]:
        """Return the messages that are sent back."""
        sent: list[dict[str, Any]] = []
        given = {"host": HOST, **headers}
        scope = {
            "type": kind,
            "path": path,
            "method": method,
            "query_string": query.encode(),
            "headers": [(name.encode(), value.encode()) for name, value in given.items()],
        }

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": body.encode()}

        async def send(message: Any) -> None:
            sent.append(message)

        asyncio.run(self.guard(scope, receive, send))
        return sent


def header(sent: list[dict[str, Any]], name: str) -> str:
    return dict(sent[0]["headers"])[name.encode()].decode()


@pytest.fixture
def site() -> Site:
    return Site("right")


def test_unknown_clients_are_sent_to_sign_in(site: Site):
    sent = site.request("/")
    assert sent[0]["status"] == 303
    assert header(sent, "location") == "/login"
    assert site.request("/login")[0]["status"] == 200
    assert site.reached == []


@pytest.mark.parametrize(
    "request_",
    [
        {"path": "/", "query": "token=wrong"},
        {"path": "/login", "method": "POST", "body": "token=wrong"},
        {"path": "/login", "method": "POST", "body": ""},
        {"path": "/login", "method": "POST", "body": "token=right&x=" + 5000 * "x"},
    ],
)
def test_a_wrong_token_is_rejected(site: Site, request_: dict[str, str]):
    sent = site.request(**request_)
    assert sent[0]["status"] == 403
    assert b"Wrong token" in sent[1]["body"]
    assert site.reached == []


@pytest.mark.parametrize(
    "request_",
    [
        {"path": "/", "query": "token=right"},
        {"path": "/login", "method": "POST", "body": "token=right"},
    ],
)
def test_the_right_one_opens_a_session_that_scripts_and_other_sites_cannot_use(
    site: Site, request_: dict[str, str]
):
    sent = site.request(**request_)
    assert (sent[0]["status"], header(sent, "location")) == (303, "/")
    cookie = header(sent, "set-cookie")
    assert "HttpOnly" in cookie
    assert "SameSite=strict" in cookie
    session = cookie.split(";")[0]
    assert site.request("/", cookie=session)[0]["status"] == 200
    site.request("/logout", cookie=session)
    assert site.request("/", cookie=session)[0]["status"] == 303


@pytest.mark.parametrize("secret", ["", "right"])
def test_a_socket_from_another_site_is_closed(secret: str):
    site = Site(secret)
    sent = site.request("/_nicegui_ws/", kind="websocket", host="localhost", origin="http://evil")
    assert [message["type"] for message in sent] == ["websocket.close"]
    assert site.reached == []


def test_a_request_from_another_site_is_rejected():
    site = Site("")
    assert site.request("/", host="localhost", origin="http://evil")[0]["status"] == 403
    assert site.request("/", host="evil")[0]["status"] == 403
    assert site.reached == []


def test_pages_cannot_be_framed_by_other_sites():
    site = Site("")
    sent = site.request("/", host="localhost")
    assert header(sent, "content-security-policy") == "frame-ancestors 'self'"


def test_a_broken_cookie_is_none(site: Site):
    assert site.request("/", cookie="worm_console")[0]["status"] == 303


def test_the_lock_is_stated_to_a_right_token(site: Site):
    for _ in range(10):
        site.request("/login", method="POST", body="token=wrong")
    sent = site.request("/login", method="POST", body="token=right")
    assert sent[0]["status"] == 403
    assert b"try again in 60 s" in sent[1]["body"]


@pytest.mark.parametrize(
    ("message", "ignored"), [("http.disconnect", True), ("http.request", False)]
)
def test_only_the_error_of_a_client_that_left_is_ignored(message: str, ignored: bool):
    async def receive() -> dict[str, Any]:
        return {"type": message}

    async def app(scope: Any, receive: Any, send: Any) -> None:
        await receive()
        raise RuntimeError("No response returned.")

    async def send(message: Any) -> None: ...

    def request() -> None:
        asyncio.run(IgnoreDisconnects(app)({"type": "http"}, receive, send))

    if ignored:
        request()
    else:
        with pytest.raises(RuntimeError):
            request()
