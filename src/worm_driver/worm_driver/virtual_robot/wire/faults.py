# SPDX-License-Identifier: Apache-2.0
"""Faults that can be injected into the virtual robot, each with a start, a duration and a target."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final

from worm_msgs.input_error import InputError

# Faults of status packets.
NO_ANSWER: Final = "no_answer"
CORRUPTED_CRC: Final = "corrupted_crc"
TRUNCATED: Final = "truncated"
DUPLICATED: Final = "duplicated"
LATE: Final = "late"
FUZZED: Final = "fuzzed"
ERROR_NUMBER: Final = "error"
WRONG_ID: Final = "wrong_id"
WRONG_POSITION: Final = "wrong_position"
# Events of the whole robot.
PUT_BACK: Final = "put_back"
OCCLUDED: Final = "occluded"
# Changes of the plant's conditions.
SLOPE: Final = "slope"
TETHER: Final = "tether"
# Faults of servos, of the serial port and of the power sensor.
VANISHED: Final = "vanished"
STALLED: Final = "stalled"
OVERLOAD: Final = "overload"
OVERHEATING: Final = "overheating"
INPUT_VOLTAGE: Final = "input_voltage"
UNPLUGGED: Final = "unplugged"
I2C_NACK: Final = "i2c_nack"
I2C_TIMEOUT: Final = "i2c_timeout"
INA219_OVERFLOW: Final = "ina219_overflow"
INA219_SATURATION: Final = "ina219_saturation"
INA219_RESET: Final = "ina219_reset"


@dataclass(frozen=True)
class FaultKind:
    """Kind of fault.

    Attributes:
        text: description.
        count: default number of times that the fault takes effect (packets, transactions or events); 0: always within
            the duration.
        duration: default duration, s.
        value: default value, in the unit of the description.
    """

    text: str
    count: int = 0
    duration: float = math.inf
    value: float = 0.0

    def __str__(self) -> str:
        length = f"count {self.count}" if self.count else f"duration {self.duration:g} s"
        return f"{self.text} ({length}" + (f", value {self.value:g})" if self.value else ")")


KINDS: dict[str, FaultKind] = {
    NO_ANSWER: FaultKind("status packets are lost", count=1),
    CORRUPTED_CRC: FaultKind("status packets have a wrong checksum", count=1),
    TRUNCATED: FaultKind("status packets end early", count=1),
    DUPLICATED: FaultKind("status packets are sent twice", count=1),
    LATE: FaultKind("status packets are value seconds late", count=1, value=0.045),
    FUZZED: FaultKind("bytes of status packets are changed, lost and added at random", count=1),
    ERROR_NUMBER: FaultKind("status packets contain error number value (1 to 7)", count=1, value=1),
    WRONG_ID: FaultKind("status packets contain value as the id of the servo", count=1, value=1),
    WRONG_POSITION: FaultKind(
        "positions in status packets are wrong by value ticks", count=1, value=600
    ),
    PUT_BACK: FaultKind("the robot is moved back to its start, with straight fins", count=1),
    OCCLUDED: FaultKind("both markers are hidden from the camera", duration=1.0),
    SLOPE: FaultKind(
        "the pipe is value degrees steeper uphill, at most vertical", duration=10.0, value=10.0
    ),
    TETHER: FaultKind(
        "the tether pulls value newtons more towards -x, at least 0 in total",
        duration=10.0,
        value=2.0,
    ),
    VANISHED: FaultKind(
        "a servo loses its supply, and boots when the supply returns", duration=1.0
    ),
    STALLED: FaultKind("a servo's shaft is blocked, which can overload the servo", duration=1.0),
    OVERLOAD: FaultKind("a servo reports overload until it is rebooted", duration=0.1),
    OVERHEATING: FaultKind("the air around a servo is 100 degC hotter", duration=1.0),
    INPUT_VOLTAGE: FaultKind("a servo's supply is at value volts", duration=1.0, value=4.0),
    UNPLUGGED: FaultKind("the serial port disappears for the duration", duration=1.0),
    I2C_NACK: FaultKind("the power sensor does not acknowledge", count=1),
    I2C_TIMEOUT: FaultKind("the I2C bus hangs for value seconds, then fails", count=1, value=0.1),
    INA219_OVERFLOW: FaultKind(
        "the current rises by value amperes, and the sensor's overflow bit is set",
        duration=0.2,
        value=6.0,
    ),
    INA219_SATURATION: FaultKind(
        "the current rises by value amperes; the sensor's overflow bit is not forced",
        duration=0.2,
        value=6.0,
    ),
    INA219_RESET: FaultKind("the sensor loses its settings in a brown-out", count=1),
}


class FaultError(InputError):
    """The fault is invalid. The message contains the remedy."""


@dataclass(frozen=True)
class Fault:
    """Fault to inject.

    Attributes:
        name: key of KINDS.
        target: id of the servo; None: any.
        start: time of the virtual robot's clock, s.
        duration: duration, s; inf: until the count is used up.
        count: number of times that the fault takes effect (packets, transactions or events); 0: always within the
            duration.
        value: value, in the unit of the description in KINDS.
    """

    name: str
    target: int | None = None
    start: float = 0.0
    duration: float = math.inf
    count: int = 0
    value: float = 0.0

    def __post_init__(self) -> None:
        if self.name not in KINDS:
            raise FaultError(f"no fault {self.name!r}: choose one of {', '.join(KINDS)}")
        if not (self.start >= 0 and self.duration >= 0 and self.count >= 0):
            raise FaultError(f"fault {self.name}: start, duration and count must not be negative")
        if not math.isfinite(self.value):
            raise FaultError(f"fault {self.name}: value must be a finite number")
        if self.name == ERROR_NUMBER and self.value not in range(1, 8):
            raise FaultError(f"fault {self.name}: value must be an error number from 1 to 7")
        if self.name == WRONG_ID and self.value not in range(253):
            raise FaultError(f"fault {self.name}: value must be a servo id from 0 to 252")

    def delayed(self, time: float) -> "Fault":
        """Return the same fault, later by a time (s)."""
        return replace(self, start=self.start + time)

    def hits(self, target: int | None) -> bool:
        """Return True if the fault affects the servo with the id ``target`` (None: a part that is not a servo)."""
        return self.target is None or self.target == target


def make_fault(
    name: str,
    *,
    target: int | None = None,
    start: float = 0.0,
    duration: float | None = None,
    count: int | None = None,
    value: float | None = None,
) -> Fault:
    """Return a fault. Missing arguments have the defaults of its kind, with two exceptions.

    - With a duration and without a count, the count is unlimited.
    - With a count and without a duration, the duration is unlimited.
    """
    kind = KINDS.get(name)
    if kind is None:
        return Fault(name)  # Raises an error that lists the names.
    if count is None:
        count = kind.count if duration is None else 0
    if duration is None:
        duration = math.inf if count else kind.duration
    return Fault(name, target, start, duration, count, kind.value if value is None else value)


def parse_fault(text: str) -> Fault:
    """Return the fault of a text ``NAME[:KEY=VALUE,…][@SECONDS]`` with keys target, duration, count, value.

    Raises:
        FaultError: The text is invalid.
    """
    head, _, start = text.partition("@")
    name, _, options = head.partition(":")
    numbers: dict[str, float] = {}
    try:
        if start:
            numbers["start"] = float(start)
        for option in filter(None, options.split(",")):
            key, _, value = option.partition("=")
            if key not in ("target", "duration", "count", "value"):
                raise FaultError(
                    f"fault {text!r}: no option {key!r} (target, duration, count, value)"
                )
            numbers[key] = int(value) if key in ("target", "count") else float(value)
    except ValueError as error:
        if isinstance(error, FaultError):
            raise
        raise FaultError(f"fault {text!r}: write NAME[:KEY=VALUE,…][@SECONDS]") from error
    return make_fault(name, **numbers)  # type: ignore[arg-type]


class FaultBoard:
    """Faults that have been injected and have not ended."""

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._left: list[tuple[Fault, int]] = []
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        self._left.append((fault, fault.count))

    def clear(self) -> None:
        """End all faults."""
        self._left.clear()

    def active(self, name: str, time: float, target: int | None = None) -> Fault | None:
        """Return the active fault with a name, for a target (id of a servo) at a time (s); None if there is none."""
        if not self._left:
            return None
        for fault, _ in self._left:
            if fault.name == name and fault.hits(target) and _is_active(fault, time):
                return fault
        return None

    def consume(self, name: str, time: float, target: int | None = None) -> Fault | None:
        """Return the fault like `active`, and reduce its remaining count by one if the count is limited."""
        fault = self.active(name, time, target)
        if fault is not None:
            index = next(i for i, (other, _) in enumerate(self._left) if other is fault)
            left = self._left[index][1] - 1
            if left == 0:
                del self._left[index]
            else:
                self._left[index] = (fault, left)
        return fault

    def forget_past(self, time: float) -> None:
        """Remove the faults that have ended at a time (s)."""
        self._left = [(f, left) for f, left in self._left if time <= f.start + f.duration]


def _is_active(fault: Fault, time: float) -> bool:
    return fault.start <= time <= fault.start + fault.duration
