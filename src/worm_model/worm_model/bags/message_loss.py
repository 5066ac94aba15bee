# SPDX-License-Identifier: Apache-2.0
"""Counts lost messages of a topic from the publishers' sequence numbers.

The middleware numbers what each publisher sends (1, 2, 3, …) but does not say which publisher a number comes from. The
number of messages lost is the progress of all publishers less the messages received, which does not depend on how
equal-looking numbers are told apart; only a publisher that joins late must not be taken for a jump of an older one.
"""

from __future__ import annotations

from collections.abc import Callable


class LossCounter:
    """Loss of one topic.

    Args:
        publishers: number of publishers that the topic has now; asked only when a number is out of turn.

    Attributes:
        lost: messages that were sent between two that were received.
        missed: messages that publishers which came later had sent before their first one was received.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._heard = 0
        self._unheard = 0
        self._last: list[
            int
        ] = []  # last number of each publisher, the least recently heard one first
        self.lost = 0
        self.missed = 0

    def expect(self, publishers: int) -> None:
        """So many publishers were there before the recording, whose earlier messages nobody asked for."""
        self._unheard = max(publishers - self._heard, 0)

    def observe(self, sequence: int) -> None:
        """Take note of a received message's sequence number (counted by its publisher, from 1)."""
        if sequence - 1 in self._last:  # the rule; all else is rare
            self._last.remove(sequence - 1)
        else:
            self._out_of_turn(sequence)
        self._last.append(sequence)

    def _out_of_turn(self, sequence: int) -> None:
        """A publisher is new, has restarted, or messages were lost."""
        publishers = max(self._publishers(), 1)
        earlier = [last for last in self._last if last < sequence]
        if earlier and len(self._last) >= publishers:
            self.lost += sequence - max(earlier) - 1
            self._last.remove(max(earlier))
        else:
            self.missed += 0 if self._unheard else sequence - 1
            self._heard += 1
            self._unheard = max(self._unheard - 1, 0)
        while len(self._last) >= publishers:  # of publishers that are gone
            self._last.pop(0)
