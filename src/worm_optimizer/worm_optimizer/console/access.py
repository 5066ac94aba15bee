# SPDX-License-Identifier: Apache-2.0
"""Who may use the console: where requests come from, the token or password, and sessions that end."""

from __future__ import annotations

import hmac
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from urllib.parse import urlsplit

SESSION_S = 12 * 3600.0  # after which one signs in again
LOCAL = ("localhost", "127.0.0.1", "::1")
# Wrong secrets in so many s, after which nobody new is let in for as long.
_FAILURES, _FAILURES_S = 10, 60.0


def is_local(address: str) -> bool:
    """Whether only this computer reaches an address on which is listened."""
    return address in LOCAL


def same_origin(headers: Mapping[str, str]) -> bool:
    """Whether a request comes from a page of this console, or from no page at all; names of headers in lower case."""
    origin = headers.get("origin")
    if origin is None:
        return True
    return bool(urlsplit(origin).netloc) and urlsplit(origin).netloc == headers.get("host", "")


class Access:
    """Without a ``secret``, everybody on this computer and nobody else; ``clock`` tells the time in s."""

    def __init__(self, secret: str, clock: Callable[[], float]) -> None:
        self._secret = secret
        self._clock = clock
        self._ends: dict[str, float] = {}
        self._failures: deque[float] = deque(maxlen=_FAILURES)

    @property
    def needs_secret(self) -> bool:
        """Whether one has to sign in."""
        return bool(self._secret)

    def admits(self, headers: Mapping[str, str], session: str) -> bool:
        """Whether a request is answered at all; a name that only resolves to this computer is no local page."""
        if not same_origin(headers):
            return False
        if self._secret:
            return self.is_open(session)
        return is_local(urlsplit(f"//{headers.get('host', '')}").hostname or "")

    def sign_in(self, offered: str) -> str:
        """A new session for the right secret, else an empty text."""
        now = self._clock()
        tired = len(self._failures) == _FAILURES and now - self._failures[0] < _FAILURES_S
        if tired or not hmac.compare_digest(offered.encode(), self._secret.encode()):
            self._failures.append(now)
            return ""
        session = secrets.token_urlsafe(32)
        self._ends[session] = now + SESSION_S
        return session

    def is_open(self, session: str) -> bool:
        """Whether a session has begun and not ended; without a secret there is nothing to end."""
        return not self._secret or self._clock() < self._ends.get(session, 0.0)

    def sign_out(self, session: str) -> None:
        """End a session."""
        self._ends.pop(session, None)
