# SPDX-License-Identifier: Apache-2.0
"""Counter of a topic's lost messages, based on the publishers' sequence numbers.

The middleware numbers the messages of each publisher (1, 2, 3, …) but does not identify the publisher of a number.
For each publisher, the number of lost messages is the increase of its numbers minus the number of its messages that
were received after its first one. The counter reports the sum over the publishers. This sum is correct even
if the counter confuses two publishers that have similar numbers. The counter uses the present number of publishers to
distinguish a publisher that joins late from lost messages.
"""

from __future__ import annotations

from collections.abc import Callable


class LossCounter:
    """Counter of the lost messages of one topic.

    Args:
        publishers: returns the present number of publishers of the topic; called only for a number out of sequence.

    Attributes:
        lost: number of missing messages between received messages of the same publisher.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        # Last sequence number of each publisher, the least recently received first
        self._last: list[int] = []
        self.lost = 0

    def observe(self, sequence: int) -> None:
        """Account for a received message with a sequence number, which its publisher counts from 1."""
        if sequence - 1 in self._last:  # the usual case
            self._last.remove(sequence - 1)
        else:
            self._observe_out_of_sequence(sequence)
        self._last.append(sequence)

    def _observe_out_of_sequence(self, sequence: int) -> None:
        """Process a number out of sequence: a publisher is new or has restarted, or messages were lost."""
        publishers = max(self._publishers(), 1)
        earlier = [last for last in self._last if last < sequence]
        if earlier and len(self._last) >= publishers:
            self.lost += sequence - max(earlier) - 1
            self._last.remove(max(earlier))
        while len(self._last) >= publishers:
            self._last.pop(0)  # the number of a publisher that has ended
