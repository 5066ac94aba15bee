# SPDX-License-Identifier: Apache-2.0
"""What goes over the servo bus and what went wrong there, as values: nothing of the SDK."""

from dataclasses import dataclass

_ERROR_TEXT = {
    1: "could not carry the instruction out",
    2: "does not know the instruction",
    3: "received a garbled question (wrong CRC): check its cable",
    4: "refuses the value: out of range, or its bus watchdog has expired",
    5: "refuses the length of the data",
    6: "refuses the value: beyond its limit register",
    7: "refuses the access (read-only, undefined, or EEPROM while torque is on)",
}


@dataclass(frozen=True)
class Identity:
    """A servo's answer to a ping."""

    model_number: int
    firmware: int


@dataclass(frozen=True)
class Reply:
    """A servo's part of a sync read.

    Attributes:
        data: the block that was asked for, in register order.
        alert: the servo reports a hardware error (see hardware_error_status).
        error: error number of the status packet, 0 for none.
        received: s, monotonic, when its last byte had come.
    """

    data: bytes
    alert: bool
    error: int
    received: float


@dataclass(frozen=True)
class BusCounters:
    """How often something went wrong since the port was opened."""

    exchanges: int = 0
    timeouts: int = 0
    corrupt: int = 0
    errors: int = 0
    stale: int = 0
    retries: int = 0


def error_text(number: int) -> str:
    """What a status packet's error number says, in words."""
    return _ERROR_TEXT.get(number, f"answers with error number {number}")
