# SPDX-License-Identifier: Apache-2.0
"""What stands before all pages and their sockets (ASGI): lets in whom `Access` admits, and signs people in."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, MutableMapping
from contextlib import suppress
from http import HTTPStatus
from typing import Any
from urllib.parse import parse_qs

from starlette.requests import ClientDisconnect, HTTPConnection, Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.websockets import WebSocketClose

from worm_optimizer.console.access import SESSION_S, Access, same_origin

COOKIE = "worm_console"
_FRAMES = b"frame-ancestors 'self'"
_LONGEST_FORM = 4096  # bytes
# Of an answer of its own, which no other site shows in a frame and whose address is told to nobody; with no-referrer,
# browsers hide the origin of the form.
_OWN = {"cache-control": "no-store", "referrer-policy": "same-origin", "x-frame-options": "DENY"}
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
        asked = HTTPConnection(scope)
        signs = scope["type"] == "http" and self._access.needs_secret and same_origin(asked.headers)
        named = scope["path"] in ("/login", "/logout") or asked.query_params.get("token")
        answer: Callable[[Scope, Receive, Send], Awaitable[None]]
        if signs and named:
            answer = await self._sign(Request(scope, receive))
        elif self._access.admits(asked.headers, asked.cookies.get(COOKIE, "")):
            await self._app(scope, receive, _unframed(send))
            return
        elif scope["type"] == "websocket":
            answer = WebSocketClose(1008)
        elif signs:
            answer = RedirectResponse("/login", HTTPStatus.SEE_OTHER, _OWN)
        else:
            text = "refused: this request does not come from a page of the console"
            answer = HTMLResponse(text, HTTPStatus.FORBIDDEN, _OWN)
        await answer(scope, receive, send)

    async def _sign(self, request: Request) -> Response:
        if request.url.path == "/logout":
            self._access.sign_out(request.cookies.get(COOKIE, ""))
            return HTMLResponse(_FORM.format("You are signed out."), headers=_OWN)
        offered = request.query_params.get("token", "")
        if request.method == "POST":
            offered = "".join(parse_qs(await _body(request)).get("token", []))
        elif not offered:
            return HTMLResponse(_FORM.format("Sign in."), headers=_OWN)
        opened = self._access.sign_in(offered)
        if not opened:
            wrong = "Wrong token or password: the console prints the token when it starts."
            return HTMLResponse(_FORM.format(wrong), HTTPStatus.FORBIDDEN, _OWN)
        answer = RedirectResponse("/", HTTPStatus.SEE_OTHER, _OWN)
        answer.set_cookie(COOKIE, opened, round(SESSION_S), httponly=True, samesite="strict")
        return answer


def _unframed(send: Send) -> Send:
    """Tells browsers that no other site may show a page in a frame, where clicks could be lured onto it."""

    async def tell(message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = [*message.get("headers", []), (b"content-security-policy", _FRAMES)]
            message = {**message, "headers": headers}
        await send(message)

    return tell


async def _body(request: Request) -> str:
    """Of a form; empty where it is longer than a form is."""
    body = b""
    with suppress(ClientDisconnect):
        async for chunk in request.stream():
            body += chunk
            if len(body) > _LONGEST_FORM:
                return ""
    return body.decode("utf-8", "replace")
