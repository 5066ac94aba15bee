# SPDX-License-Identifier: Apache-2.0
"""Control of the robot by the pages of one console.

Each page is a client of the driver. At any time, the driver grants control to at most one page of all consoles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from worm_optimizer.snapshot import Control, Wish

# Text between the name of the console and that of the page in the name of a client
_SEPARATOR = " page "

Send = Callable[[str, Wish, float], None]


@dataclass
class _Page:
    """State of one page."""

    last_message_s: float = -math.inf
    wants_control: bool = False
    has_control: bool = False
    loss: str = ""  # reason why the page last lost control or its request for it


class ConsoleControl:
    """Requests of the pages of this console for control, and the driver's decisions about them.

    Args:
        console: name of this console, which is unique among all consoles.
        clock: returns the present time, s.
        send: sends three values to the driver: name of a client, its wish, and a time (s). The driver ends the control
            of a client that does not renew its request within this time.
        timeout_s: time without a message from a page after which the page loses control, s.
    """

    def __init__(
        self, console: str, clock: Callable[[], float], send: Send, timeout_s: float
    ) -> None:
        self._console = console
        self._clock = clock
        self._submit = send
        self.timeout_s = timeout_s
        self._pages: dict[str, _Page] = {}
        self._state = Control()
        self._runner = ""  # client that must have control for the present run to continue

    def update(self, state: Control | None) -> None:
        """Set which client has control and which requests it, according to the driver; None without a driver."""
        self._state = state or Control()
        for name, page in self._pages.items():
            has_control = page.wants_control and self._state.holder == self._client(name)
            if page.has_control and not has_control and page.wants_control:
                why = self._state.holder and f": {self._named(self._state.holder)} has it"
                self._drop(name, f"this page lost control{why}")
            page.has_control = has_control

    def on_message(self, name: str) -> None:
        """Register a message of a page, and renew its request. A page that was silent for too long loses control."""
        page = self._page(name)
        now = self._clock()
        if page.wants_control and now - page.last_message_s > self.timeout_s:
            self._drop(
                name, f"this page was silent for more than {self.timeout_s:g} s and lost control"
            )
        page.last_message_s = now
        if page.wants_control:
            self._send(name, Wish.CONTROL)

    def request(self, name: str) -> None:
        """Request control for a page. `is_held_by` becomes True when the driver grants it."""
        page = self._page(name)
        page.loss = ""
        page.wants_control = True
        page.last_message_s = self._clock()
        self._send(name, Wish.CONTROL)

    def hand_over(self, name: str) -> None:
        """Hand control over from a page to the client that requests it. A run continues under that client."""
        if self.is_held_by(name) and self._state.requester:
            self._runner = self._state.requester
            self._send(name, Wish.HAND_OVER)
            page = self._page(name)
            page.wants_control = page.has_control = False

    def release(self, name: str, loss: str = "") -> None:
        """Release a page's control, or its request for control.

        Args:
            name: the page.
            loss: reason, which `loss_of` returns; empty if the person at the page decided it.
        """
        if name in self._pages and self._pages[name].wants_control:
            self._drop(name, loss)

    def forget(self, name: str) -> None:
        """Release the control of a page that does not exist any more."""
        self.release(name)
        self._pages.pop(name, None)

    def is_held_by(self, name: str) -> bool:
        """Return True if a page has control and is not silent."""
        page = self._pages.get(name)
        return page is not None and page.has_control and not self._is_silent(page)

    def is_requested_by(self, name: str) -> bool:
        """Return True if a page wants control and does not have it yet."""
        page = self._pages.get(name)
        return page is not None and page.wants_control and not page.has_control

    @property
    def holder(self) -> str:
        """Name of the page that has control, as shown to people, see `_named`; empty if there is none."""
        return self._state.holder and self._named(self._state.holder)

    @property
    def requester(self) -> str:
        """Name of the page that requests control, as shown to people; empty if there is none."""
        return self._state.requester and self._named(self._state.requester)

    def loss_of(self, name: str) -> str:
        """Return the reason why a page has lost control or its request; empty if none was lost.

        It is also empty if the person at the page released control or withdrew the request.
        """
        page = self._pages.get(name)
        return "" if page is None else page.loss

    def begin_run(self) -> None:
        """Register that a run starts for the client that has control now."""
        self._runner = self._state.holder

    @property
    def run_loss(self) -> str:
        """Reason why the present run must end; empty while the client for which it runs has control."""
        runner, holder = self._runner, self._state.holder
        if not holder:
            return "no page has control"
        if holder != runner:
            return f"{self._named(holder)} has control and did not start this run"
        console, _, name = runner.partition(_SEPARATOR)
        if console == self._console and not self.is_held_by(name):
            return f"the page that had control was closed, or silent for {self.timeout_s:g} s"
        return ""

    def _drop(self, name: str, loss: str) -> None:
        page = self._page(name)
        page.loss = loss
        page.wants_control = page.has_control = False
        self._send(name, Wish.RELEASE)

    def _send(self, name: str, wish: Wish) -> None:
        self._submit(self._client(name), wish, self.timeout_s)

    def _is_silent(self, page: _Page) -> bool:
        return self._clock() - page.last_message_s > self.timeout_s

    def _page(self, name: str) -> _Page:
        return self._pages.setdefault(name, _Page())

    def _client(self, name: str) -> str:
        return f"{self._console}{_SEPARATOR}{name}"

    def _named(self, client: str) -> str:
        """Return the name of a client as shown to people: "another page", or "a page of" and another console's name."""
        console = client.split(_SEPARATOR)[0]
        return "another page" if console == self._console else f"a page of {console}"
