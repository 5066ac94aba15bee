# SPDX-License-Identifier: Apache-2.0
"""Answers of the servos, texts of their errors, and counters of failures. Independent of dynamixel_sdk."""

from dataclasses import dataclass

_ERROR_TEXT = {
    1: "could not carry the instruction out",
    2: "does not support the instruction",
    3: "received a garbled request (wrong CRC): check its cable",
    4: "rejects the value: out of range, or its bus watchdog has expired",
    5: "rejects the length of the data",
    6: "rejects the value: beyond its limit register",
    7: "rejects the access (read-only, undefined, or EEPROM while torque is on)",
}


@dataclass(frozen=True)
class Identity:
    """Answer of a servo to a ping."""

    model_number: int
    firmware: int


@dataclass(frozen=True)
class Reply:
    """Answer of one servo to a request (status packet).

    Attributes:
        data: bytes of the requested registers, in the order of their addresses; empty after a write.
        alert: True if the servo reports a hardware error (see hardware_error_status).
        error: error number of the status packet, 0 for none.
        received: time at which the driver had read the whole packet, s, monotonic.
    """

    data: bytes
    alert: bool
    error: int
    received: float

    def repeats(self, other: "Reply") -> bool:
        """Return True if both replies have the same content. Their times of reception may differ."""
        return (self.data, self.alert, self.error) == (other.data, other.alert, other.error)


@dataclass(frozen=True)
class BusCounters:
    """Numbers of exchanges and of failures since the port was opened.

    Attributes:
        exchanges: requests to servos, including group writes and broadcasts, which have no answer.
        timeouts: requests to one servo without an answer, and sync reads in which a usable answer is missing.
        corrupt: garbled or contradictory answers, and answers of a wrong length; in sync reads also answers of servos
            that were not requested.
        errors: answers with an error number.
        stale: answers that are older than their request.
        implausible: positions that their servo cannot have reached.
        withheld: goals that were not written because they are out of bounds.
        retries: repetitions of requests to a single servo.
    """

    exchanges: int = 0
    timeouts: int = 0
    corrupt: int = 0
    errors: int = 0
    stale: int = 0
    implausible: int = 0
    withheld: int = 0
    retries: int = 0


def error_text(number: int) -> str:
    """Return the meaning of a status packet's error number."""
    return _ERROR_TEXT.get(number, f"answers with error number {number}")
