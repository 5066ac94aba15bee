# SPDX-License-Identifier: Apache-2.0
"""Faults that can be injected into the virtual robot, each with a start, a duration and a target."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from worm_msgs.input_error import InputError


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
    # Faults of status packets.
    "no_answer": FaultKind("status packets are lost", count=1),
    "corrupted_crc": FaultKind("status packets have a wrong checksum", count=1),
    "truncated": FaultKind("status packets end early", count=1),
    "duplicated": FaultKind("status packets are sent twice", count=1),
    "late": FaultKind("status packets are value seconds late", count=1, value=0.045),
    "fuzzed": FaultKind("bytes of status packets are changed, lost and added at random", count=1),
    "error": FaultKind("status packets contain error number value (1 to 7)", count=1, value=1),
    "wrong_id": FaultKind("status packets contain value as the id of the servo", count=1, value=1),
    "wrong_position": FaultKind(
        "positions in status packets are wrong by value ticks", count=1, value=600
    ),
    # Events of the whole robot, and changes of its conditions.
    "put_back": FaultKind("the robot is moved back to its start, with straight fins", count=1),
    "occluded": FaultKind("both markers are hidden from the camera", duration=1.0),
    "slope": FaultKind(
        "the pipe is value degrees steeper uphill, at most vertical", duration=10.0, value=10.0
    ),
    "tether": FaultKind(
        "the tether pulls value newtons more towards -x, at least 0 in total",
        duration=10.0,
        value=2.0,
    ),
    # Faults of servos, of the serial port and of the power sensor.
    "vanished": FaultKind(
        "a servo loses its supply, and boots when the supply returns", duration=1.0
    ),
    "stalled": FaultKind("a servo's shaft is blocked, which can overload the servo", duration=1.0),
    "overload": FaultKind("a servo reports overload until it is rebooted", duration=0.1),
    "overheating": FaultKind("the air around a servo is 100 degC hotter", duration=1.0),
    "input_voltage": FaultKind("a servo's supply is at value volts", duration=1.0, value=4.0),
    "unplugged": FaultKind("the serial port disappears for the duration", duration=1.0),
    "i2c_nack": FaultKind("the power sensor does not acknowledge", count=1),
    "i2c_timeout": FaultKind("the I2C bus hangs for value seconds, then fails", count=1, value=0.1),
    "ina219_overflow": FaultKind(
        "the current rises by value amperes, and the sensor's overflow bit is set",
        duration=0.2,
        value=6.0,
    ),
    "ina219_saturation": FaultKind(
        "the current rises by value amperes; the sensor's overflow bit is not forced",
        duration=0.2,
        value=6.0,
    ),
    "ina219_reset": FaultKind("the sensor loses its settings in a brown-out", count=1),
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
        if self.name == "error" and self.value not in range(1, 8):
            raise FaultError(f"fault {self.name}: value must be an error number from 1 to 7")
        if self.name == "wrong_id" and self.value not in range(253):
            raise FaultError(f"fault {self.name}: value must be a servo id from 0 to 252")

    def delayed(self, time: float) -> "Fault":
        """Return the same fault, later by a time (s)."""
        return replace(self, start=self.start + time)

    def affects(self, target: int | None, time: float) -> bool:
        """Return True if the fault affects a servo (None: a part that is not a servo) at a time (s)."""
        return self.target in (None, target) and self.start <= time <= self.start + self.duration


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
    """Return the fault of a text ``NAME[:KEY=VALUE,…][@SECONDS]`` with keys target, duration, count, value."""
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
        self._faults = list(faults)

    def add(self, fault: Fault) -> None:
        """Add a fault."""
        self._faults.append(fault)

    def clear(self) -> None:
        """End all faults."""
        self._faults.clear()

    def active(self, name: str, time: float, target: int | None = None) -> Fault | None:
        """Return the active fault with a name, for a target (id of a servo) at a time (s); None if there is none."""
        for fault in self._faults:
            if fault.name == name and fault.affects(target, time):
                return fault
        return None

    def consume(self, name: str, time: float, target: int | None = None) -> Fault | None:
        """Return the fault like `active`, and reduce its remaining count by one if the count is limited."""
        fault = self.active(name, time, target)
        if fault is not None and fault.count:
            index = next(i for i, other in enumerate(self._faults) if other is fault)
            left = [replace(fault, count=fault.count - 1)] if fault.count > 1 else []
            self._faults[index : index + 1] = left
        return fault

    def forget_past(self, time: float) -> None:
        """Remove the faults that have ended at a time (s)."""
        self._faults = [fault for fault in self._faults if time <= fault.start + fault.duration]
