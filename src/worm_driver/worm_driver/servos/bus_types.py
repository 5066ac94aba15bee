# SPDX-License-Identifier: Apache-2.0
"""Values that pass over the servo bus and counters of its failures, independent of the SDK."""

from dataclasses import dataclass

_ERROR_TEXT = {
    1: "could not carry the instruction out",
    2: "does not support the instruction",
    3: "received a garbled question (wrong CRC): check its cable",
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
    """Part of one servo in a sync read.

    Attributes:
        data: requested block, in register order.
        alert: True if the servo reports a hardware error (see hardware_error_status).
        error: error number of the status packet, 0 for none.
        received: time at which its last byte was received, s, monotonic.
    """

    data: bytes
    alert: bool
    error: int
    received: float

    def repeats(self, other: "Reply") -> bool:
        """Return True if both replies have the same content, whatever the times at which they were received."""
        return (self.data, self.alert, self.error) == (other.data, other.alert, other.error)


@dataclass(frozen=True)
class BusCounters:
    """Numbers of exchanges and of failures since the port was opened.

    Attributes:
        exchanges: exchanges on the bus.
        timeouts: exchanges in which an answer is missing.
        corrupt: garbled, unexpected or contradictory answers.
        errors: answers with an error number.
        stale: answers that are older than their request.
        implausible: positions that their servo cannot have reached.
        withheld: goals that were not written because they are out of bounds.
        retries: repeated exchanges.
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
