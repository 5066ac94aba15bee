# SPDX-License-Identifier: Apache-2.0
"""Control of the robot by the pages of the console: at most one page at a time may command it."""

from __future__ import annotations

import math
from collections.abc import Callable


class PageControl:
    """Decides which page has control.

    The thread of the web server calls all methods; other threads read `run_loss`.

    Args:
        clock: returns the present time, s.
        timeout_s: time without a message from a page after which the page loses control, s.

    Attributes:
        holder: page that has control; empty if there is none.
        requester: page that requests control; empty if there is none.
    """

    def __init__(self, clock: Callable[[], float], timeout_s: float) -> None:
        self.timeout_s = timeout_s
        self.holder = self.requester = ""
        self._clock = clock
        self._last_message: dict[str, float] = {}
        self._loss: dict[str, str] = {}
        self._runner = ""  # page that must have control for the present run to continue

    def on_message(self, page: str) -> None:
        """Register a message of a page. A page that was silent for too long loses control first."""
        self.expire()
        self._last_message[page] = self._clock()

    def expire(self) -> None:
        """End control and request of pages that are silent for too long."""
        for page in (self.requester, self.holder):
            if page and self._is_silent(page):
                text = f"this page was silent for more than {self.timeout_s:g} s and lost control"
                self.release(page, text)

    def request(self, page: str) -> None:
        """Give control to a page if no other page has it. Otherwise store the request, unless another page waits."""
        self.on_message(page)
        self._loss.pop(page, None)
        if not self.holder:
            self.holder = page
        elif page != self.holder and not self.requester:
            self.requester = page

    def hand_over(self, page: str) -> None:
        """Hand control over from a page to the page that requests it. A run continues under that page."""
        if page == self.holder and self.requester:
            self.holder, self.requester = self.requester, ""
            self._runner = self.holder

    def release(self, page: str, loss: str = "") -> None:
        """Release a page's control, which a page that requests it then receives, or its request for control.

        Args:
            page: the page.
            loss: reason, which `loss_of` returns; empty if the person at the page decided it.
        """
        if page not in (self.holder, self.requester):
            return
        if page == self.holder:
            self.holder = self.requester
        self.requester = ""
        self._loss[page] = loss

    def forget(self, page: str) -> None:
        """Release the control of a page that does not exist any more."""
        self.release(page)
        self._last_message.pop(page, None)
        self._loss.pop(page, None)

    def is_held_by(self, page: str) -> bool:
        """Return True if a page has control and is not silent."""
        return bool(page) and page == self.holder and not self._is_silent(page)

    def loss_of(self, page: str) -> str:
        """Return the reason why a page has lost control or its request; empty if none was lost."""
        return self._loss.get(page, "")

    def begin_run(self) -> None:
        """Register that a run starts for the page that has control now."""
        self._runner = self.holder

    @property
    def run_loss(self) -> str:
        """Reason why the present run must end; empty while the page for which it runs has control."""
        if self.is_held_by(self._runner):
            return ""
        return (
            f"the page that had control released it, was closed, or silent for {self.timeout_s:g} s"
        )

    def _is_silent(self, page: str) -> bool:
        return self._clock() - self._last_message.get(page, -math.inf) > self.timeout_s
