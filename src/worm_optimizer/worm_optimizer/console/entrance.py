# SPDX-License-Identifier: Apache-2.0
"""ASGI middleware in front of all pages and sockets: permits requests by `Access`, and serves the sign-in."""

from __future__ import annotations

import math
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
# Headers of the guard's own responses: no other site may show them in a frame or receive their address. The policy
# no-referrer would also hide the origin of the sign-in form, which `same_origin` needs.
_OWN = {"cache-control": "no-store", "referrer-policy": "same-origin", "x-frame-options": "DENY"}
_FORM = """<!doctype html><html lang="en"><meta charset="utf-8"><title>Worm console</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<body style="font-family:sans-serif;max-width:24rem;margin:4rem auto;padding:1rem"><main>
<h1>Worm console</h1>
<p role="alert">{0}</p><form method="post" action="/login"><label>Token or password
<input type="password" name="token" autocomplete="current-password" autofocus
 style="width:100%;font-size:1.2rem"></label>
<p><button style="font-size:1.2rem">Sign in</button></form></main>"""

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]


class Guard:
    """ASGI application that passes permitted requests on to another one."""

    def __init__(self, app: Any, access: Access) -> None:
        self._app = app
        self._access = access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a permitted request on. Answer any other one with the sign-in or a rejection."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        request = HTTPConnection(scope)
        signs = (
            scope["type"] == "http" and self._access.needs_secret and same_origin(request.headers)
        )
        named = scope["path"] in ("/login", "/logout") or request.query_params.get("token")
        response: Callable[[Scope, Receive, Send], Awaitable[None]]
        if signs and named:
            response = await self._sign(Request(scope, receive))
        elif self._access.admits(request.headers, request.cookies.get(COOKIE, "")):
            await self._app(scope, receive, _unframed(send))
            return
        elif scope["type"] == "websocket":
            response = WebSocketClose(1008)
        elif signs:
            response = RedirectResponse("/login", HTTPStatus.SEE_OTHER, _OWN)
        else:
            text = "rejected: this request does not come from a page of the console"
            response = HTMLResponse(text, HTTPStatus.FORBIDDEN, _OWN)
        await response(scope, receive, send)

    async def _sign(self, request: Request) -> Response:
        if request.url.path == "/logout":
            self._access.sign_out(request.cookies.get(COOKIE, ""))
            return HTMLResponse(_FORM.format("You are signed out."), headers=_OWN)
        offered = request.query_params.get("token", "")
        if request.method == "POST":
            offered = "".join(parse_qs(await _body(request)).get("token", []))
        elif not offered:
            return HTMLResponse(_FORM.format("Sign in."), headers=_OWN)
        address = request.client.host if request.client else ""
        opened = self._access.sign_in(offered, address)
        if not opened:
            wrong = "Wrong token or password: the console prints the token when it starts."
            if lock_s := self._access.lock_s(address):
                wrong = f"Too many wrong attempts: try again in {math.ceil(lock_s)} s."
            return HTMLResponse(_FORM.format(wrong), HTTPStatus.FORBIDDEN, _OWN)
        response = RedirectResponse("/", HTTPStatus.SEE_OTHER, _OWN)
        response.set_cookie(COOKIE, opened, round(SESSION_S), httponly=True, samesite="strict")
        return response


class IgnoreDisconnects:
    """ASGI application that calls another one and suppresses its error when a client leaves before the response."""

    def __init__(self, app: Any) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on. Starlette's middleware raises RuntimeError if the client leaves before the response."""
        has_left = False

        async def noting_receive() -> Any:
            nonlocal has_left
            message = await receive()
            has_left = has_left or message["type"] == "http.disconnect"
            return message

        try:
            await self._app(scope, noting_receive, send)
        except RuntimeError:
            if not has_left:
                raise


def _unframed(send: Send) -> Send:
    """Return ``send`` with a header that forbids other sites to show a page in a frame and capture its clicks."""

    async def send_with_header(message: Any) -> None:
        if message["type"] == "http.response.start":
            headers = [*message.get("headers", []), (b"content-security-policy", _FRAMES)]
            message = {**message, "headers": headers}
        await send(message)

    return send_with_header


async def _body(request: Request) -> str:
    """Return the body of a form; empty if it is longer than `_LONGEST_FORM`."""
    body = b""
    with suppress(ClientDisconnect):
        async for chunk in request.stream():
            body += chunk
            if len(body) > _LONGEST_FORM:
                return ""
    return body.decode("utf-8", "replace")
