# SPDX-License-Identifier: Apache-2.0
"""Which page holds control of the robot: one at a time, and handed over on purpose."""

from __future__ import annotations

import math
from collections.abc import Callable

SILENCE_S = 3.0  # of the page that holds control, which a run puts up with


class Control:
    """Pages by their names; ``clock`` tells the time in s.

    Attributes:
        holder: the page that holds control, empty: none.
        asking: the page that asks for it, empty: none.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._seen: dict[str, float] = {}
        self.holder = ""
        self.asking = ""

    def beat(self, page: str) -> None:
        """A page says that it lives."""
        self._seen[page] = self._clock()

    def take(self, page: str) -> bool:
        """Take control if no living page has it, else ask for it; whether it was taken."""
        if self.holder in ("", page) or not self.held:
            self.holder, self.asking = page, ""
            return True
        self.asking = page
        return False

    def hand_over(self, page: str) -> None:
        """Give control to the page that asks for it; only its holder can."""
        if page == self.holder and self.asking:
            self.holder, self.asking = self.asking, ""

    def release(self, page: str) -> None:
        """Let go of control, as a page does that is closed."""
        self._seen.pop(page, None)
        if self.holder == page:
            self.holder = ""
        if self.asking == page:
            self.asking = ""

    def is_held_by(self, page: str) -> bool:
        """Whether a page has control."""
        return bool(page) and self.holder == page

    @property
    def held(self) -> bool:
        """Whether a page that lives has control: else nobody wants what the robot does."""
        return not self.loss

    @property
    def loss(self) -> str:
        """Why no page has control, in words, empty: one has."""
        if not self.holder:
            return "no page holds control"
        silent = self._clock() - self._seen.get(self.holder, -math.inf) > SILENCE_S
        return f"the page in control was not heard for {SILENCE_S:g} s" if silent else ""
