# SPDX-License-Identifier: Apache-2.0
"""What stands before all pages and their sockets (ASGI): lets in whom `Access` admits, and signs people in."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from worm_optimizer.console.access import SESSION_S, Access, same_origin

COOKIE = "worm_console"
_FRAMES = b"frame-ancestors 'self'"
_LONGEST_FORM = 4096  # bytes
_FORM = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Worm console</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<body style="font-family:sans-serif;max-width:24rem;margin:4rem auto;padding:1rem">
<h1>Worm console</h1>
<p role="alert">{0}</p><form method="post" action="/login"><label>Token or password
<input type="password" name="token" autocomplete="current-password" autofocus
 style="width:100%;font-size:1.2rem"></label>
<p><button style="font-size:1.2rem">Sign in</button></form>"""

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]


class Guard:
    """Wraps an ASGI application."""

    def __init__(self, app: Any, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Hands on what may pass, and answers the rest."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = headers_of(scope)
        signs = scope["type"] == "http" and self._access.needs_secret and same_origin(headers)
        if signs and (scope["path"] in ("/login", "/logout") or _token(scope)):
            await self._sign(scope, receive, send)
        elif self._access.admits(headers, session_of(headers.get("cookie", ""))):
            await self._app(scope, receive, _unframed(send))
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        elif signs:
            await _answer(send, HTTPStatus.SEE_OTHER, "", [("location", "/login")])
        else:
            text = "refused: this request does not come from a page of the console"
            await _answer(send, HTTPStatus.FORBIDDEN, text)

    async def _sign(self, scope: Scope, receive: Receive, send: Send) -> None:
        session = session_of(headers_of(scope).get("cookie", ""))
        if scope["path"] == "/logout":
            self._access.sign_out(session)
            await _answer(send, HTTPStatus.OK, _FORM.format("You are signed out."))
            return
        offered = _token(scope)
        if scope["method"] == "POST":
            offered = "".join(parse_qs(await _body(receive)).get("token", []))
        elif not offered:
            await _answer(send, HTTPStatus.OK, _FORM.format("Sign in."))
            return
        opened = self._access.sign_in(offered)
        if not opened:
            wrong = "Wrong token or password: the console prints the token when it starts."
            await _answer(send, HTTPStatus.FORBIDDEN, _FORM.format(wrong))
            return
        cookie = f"{COOKIE}={opened}; HttpOnly; SameSite=Strict; Path=/; Max-Age={SESSION_S:.0f}"
        await _answer(send, HTTPStatus.SEE_OTHER, "", [("location", "/"), ("set-cookie", cookie)])


def headers_of(scope: Scope) -> dict[str, str]:
    """The headers of a request, their names in lower case."""
    return {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}


def session_of(cookie: str) -> str:
    """The session that a cookie header names, empty: none."""
    try:
        found = SimpleCookie(cookie).get(COOKIE)
    except CookieError:
        return ""
    return found.value if found is not None else ""


def _unframed(send: Send) -> Send:
    """Tells browsers that no other site may show a page in a frame, where clicks could be lured onto it."""

    async def tell(message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = [*message.get("headers", []), (b"content-security-policy", _FRAMES)]
            message = {**message, "headers": headers}
        await send(message)

    return tell


def _token(scope: Scope) -> str:
    """The token in an address, as the one that is printed has it."""
    return "".join(parse_qs(scope["query_string"].decode("latin-1")).get("token", []))


async def _body(receive: Receive) -> str:
    body = b""
    while len(body) <= _LONGEST_FORM:
        message = await receive()
        body += message.get("body", b"")
        if not message.get("more_body"):
            break
    return body.decode("utf-8", "replace") if len(body) <= _LONGEST_FORM else ""


async def _answer(
    send: Send, status: HTTPStatus, text: str, headers: list[tuple[str, str]] | None = None
) -> None:
    """A page of its own, which no other site shows in a frame and whose address is told to nobody."""
    rows = [
        ("content-type", "text/html; charset=utf-8"),
        ("cache-control", "no-store"),
        (
            "referrer-policy",
            "same-origin",
        ),  # with no-referrer, browsers hide the origin of the form
        ("x-frame-options", "DENY"),
        *(headers or []),
    ]
    encoded = [(name.encode(), value.encode()) for name, value in rows]
    await send({"type": "http.response.start", "status": int(status), "headers": encoded})
    await send({"type": "http.response.body", "body": text.encode()})
