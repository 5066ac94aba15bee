# SPDX-License-Identifier: Apache-2.0
"""Access to the console: origin of requests, token or password, and sessions, which expire."""

from __future__ import annotations

import hmac
import secrets
from collections import deque
from collections.abc import Callable, Mapping
from urllib.parse import SplitResult, urlsplit

SESSION_S = 12 * 3600.0  # duration of a session, s
LOCAL = ("localhost", "127.0.0.1", "::1")
# An address cannot sign in while its latest _FAILURES wrong secrets are all younger than _FAILURES_S (s).
_FAILURES, _FAILURES_S = 10, 60.0


def is_local(address: str) -> bool:
    """Return True if a server at an address is reachable from this computer only."""
    return address in LOCAL


def same_origin(headers: Mapping[str, str]) -> bool:
    """Return True unless a request names another origin than this console in its header Origin.

    For a link or an image, a browser does not send this header, even if the page belongs to another site.

    Args:
        headers: headers of the request, with names in lower case.
    """
    origin = headers.get("origin")
    if origin is None:
        return True
    named = _split(origin).netloc
    return bool(named) and named == headers.get("host", "")


def _split(url: str) -> SplitResult:
    """Return the parts of a URL, which are empty for a malformed one."""
    try:
        return urlsplit(url)
    except ValueError:
        return urlsplit("")


class Access:
    """Rules of access and open sessions.

    Args:
        secret: token or password. If it is empty, all users of this computer have access, and no others.
        clock: returns the present time, s.
    """

    def __init__(self, secret: str, clock: Callable[[], float]) -> None:
        self._secret = secret
        self._clock = clock
        self._ends: dict[str, float] = {}
        # Times of the latest wrong secrets, by address
        self._failures: dict[str, deque[float]] = {}

    @property
    def needs_secret(self) -> bool:
        """True if access requires a sign-in."""
        return bool(self._secret)

    def admits(self, headers: Mapping[str, str], session: str) -> bool:
        """Return True if a request is permitted.

        A request that names another origin is always rejected. If there is a secret, the session must be open. If
        there is none, the request must name one of `LOCAL` as its host, so that a foreign host name that resolves to
        this computer is rejected.

        Args:
            headers: headers of the request, with names in lower case.
            session: name of the session, from the cookie of the request.
        """
        if not same_origin(headers):
            return False
        if self._secret:
            return self.is_open(session)
        return is_local(_split(f"//{headers.get('host', '')}").hostname or "")

    def sign_in(self, offered: str, address: str) -> str:
        """Return a new session for the right secret; an empty text for a wrong one, or while the address is locked."""
        now = self._clock()
        if self.lock_s(address) > 0.0:
            return ""
        if not hmac.compare_digest(offered.encode(), self._secret.encode()):
            recent = {
                a: times for a, times in self._failures.items() if now - times[-1] < _FAILURES_S
            }
            recent.setdefault(address, deque(maxlen=_FAILURES)).append(now)
            self._failures = recent
            return ""
        session = secrets.token_urlsafe(32)
        self._ends[session] = now + SESSION_S
        return session

    def lock_s(self, address: str) -> float:
        """Return the time for which an address cannot sign in after too many wrong secrets, s; 0 if it can."""
        failures = self._failures.get(address)
        if failures is None or len(failures) < _FAILURES:
            return 0.0
        return max(failures[0] + _FAILURES_S - self._clock(), 0.0)

    def is_open(self, session: str) -> bool:
        """Return True if a session is open. Without a secret, every session is open."""
        return not self._secret or self._clock() < self._ends.get(session, 0.0)

    def sign_out(self, session: str) -> None:
        """End a session."""
        self._ends.pop(session, None)
