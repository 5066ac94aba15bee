# SPDX-License-Identifier: Apache-2.0
"""One servo at a time: who is it, is it fit, and setting it up. Used outside of the 100 Hz cycle.

What is decided by is read twice on a quiet line, and what changes a meaning (mode, limits, home) is read back so: an
answer that is late must not pass for the one to this question. The bus is to be patient meanwhile.

The led register of a cable servo is the mark of its home: lit while the turn count is valid. It is RAM, so a reboot
or a power cut, which fold the turn count, put it out, whoever was watching.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from worm_driver.control.supervision import Limits
from worm_driver.errors import BusError, ConfigurationError, CorruptReplyError, HomingError
from worm_driver.servos.encoding import from_raw, to_raw, unpack_from
from worm_driver.servos.registers import (
    EXTENDED_POSITION_MODE,
    MODELS,
    POSITION_MODE,
    Register,
    ServoModel,
    hardware_error_text,
)
from worm_driver.servos.servo_bus import ServoBus

#: pairs of readings, of which one must agree
_PAIRS = 4
#: raw, by which two readings of a measured register may differ
_UNSTEADY = {"present_position": 3, "present_input_voltage": 3}
#: ticks, by which a servo may stand off 0 after homing: a robot that was just let go still creeps
_HOME_TOLERANCE = 10
#: ticks, homing offset the servos accept (e-manual, homing offset)
_HOMING_OFFSET_LIMIT = 1_044_479


#: by how much a servo's own limit lies above the level of a fault, so that the fault can be seen
_HEADROOM = 1.1


@dataclass(frozen=True)
class Servo:
    """A servo that answered, and what it said of itself.

    Attributes:
        velocity_limit: rad/s, the least of its register and of what the shaft can do.
        voltage_range: V, least and largest supply that its registers allow.
        temperature_limit: degC, at which it shuts down.
    """

    number: int
    model: ServoModel
    firmware: int
    velocity_limit: float
    voltage_range: tuple[float, float]
    temperature_limit: float

    def __getitem__(self, name: str) -> Register:
        return self.model[name]


def identify(bus: ServoBus, number: int) -> Servo:
    """Pings a servo and reads its limits.

    Raises BusError: it does not answer; ConfigurationError: it has no control table here, or too old a firmware.
    """
    identity = bus.ping(number)
    model = MODELS.get(identity.model_number)
    if model is None:
        known = ", ".join(f"{m.name} ({m.number})" for m in MODELS.values())
        raise ConfigurationError(
            f"servo {number} is of model number {identity.model_number}, which has no control table "
            f"here; there are {known}"
        )
    if identity.firmware < model.minimum_firmware:
        raise ConfigurationError(
            f"servo {number} ({model.name}) has firmware {identity.firmware}, which has no bus watchdog: "
            f"update it to {model.minimum_firmware} or later with Dynamixel Wizard"
        )

    names = ("velocity_limit", "min_voltage_limit", "max_voltage_limit", "temperature_limit")
    values = _registers(bus, number, model, names)
    speed, low, high, temperature = (from_raw(model[name], values[name]) for name in names)
    return Servo(number, model, identity.firmware, speed, (low, high), temperature)


def registers(bus: ServoBus, servo: Servo, *names: str) -> Mapping[str, int]:
    """Raw values by name, as two readings on a quiet line agree on them. Raises BusError."""
    return _registers(bus, servo.number, servo.model, names)


def _registers(
    bus: ServoBus, number: int, model: ServoModel, names: Sequence[str]
) -> Mapping[str, int]:
    rows = [model[name] for name in names]
    start, end = min(row.address for row in rows), max(row.end for row in rows)

    def read() -> dict[str, int]:
        block = bus.read_block(number, start, end - start)
        return {row.name: unpack_from(row, block, start) for row in rows}

    for _ in range(_PAIRS):
        bus.unsettle()
        first, second = read(), read()
        if all(abs(first[n] - second[n]) <= _UNSTEADY.get(n, 0) for n in names):
            return second
    raise CorruptReplyError(
        f"servo {number} gives another {', '.join(names)} each time it is asked"
    )


def store(bus: ServoBus, servo: Servo, name: str, raw: int) -> None:
    """Sets a register that others are understood by, and makes sure of it. Raises BusError."""
    bus.write(servo.number, servo[name], raw)
    stored = registers(bus, servo, name)[name]
    if stored != raw:
        raise CorruptReplyError(
            f"servo {servo.number} has {stored} in {name}, not the {raw} that was written: try again"
        )


def check(bus: ServoBus, servo: Servo) -> None:
    """Raises ConfigurationError when a servo reports a fault, or its supply is out of range."""
    values = registers(bus, servo, "hardware_error_status", "present_input_voltage")
    status = values["hardware_error_status"]
    if status:
        raise ConfigurationError(
            f"servo {servo.number} reports {hardware_error_text(status)}: mend the cause, then call the "
            "service reboot"
        )
    voltage = from_raw(servo["present_input_voltage"], values["present_input_voltage"])
    low, high = servo.voltage_range
    if not low <= voltage <= high:
        raise ConfigurationError(
            f"servo {servo.number} ({servo.model.name}) has {voltage:.1f} V, it needs {low:.1f} to "
            f"{high:.1f} V: check the supply"
        )


def own_limit(servo: Servo, limits: Limits) -> float:
    """What a cable servo itself limits its output to: A, or a ratio of the load where it measures no current."""
    if servo.model.measures_current:
        return min(_HEADROOM * limits.max_current, servo.model.strongest_current)
    return min(_HEADROOM * limits.max_load, 1.0)


def fault_level(servo: Servo, limits: Limits) -> float:
    """Effort above which a cable servo is overloaded; unit as of own_limit."""
    return own_limit(servo, limits) / _HEADROOM


def prepare(
    bus: ServoBus, servo: Servo, mode: int, settings: Mapping[str, int] = MappingProxyType({})
) -> None:
    """Takes the torque off and sets the EEPROM up: mode, direct drive, answers at once. Raises BusError.

    A servo that was in another mode has folded its turn count: its home mark is put out. Only what differs is
    written, as the EEPROM wears. ``settings`` are further registers by name, raw.
    """
    bus.write(servo.number, servo["torque_enable"], 0)
    bus.write(servo.number, servo["status_return_level"], 2)
    wanted = {"return_delay_time": 0, "drive_mode": 0, "operating_mode": mode, **settings}
    values = registers(bus, servo, "torque_enable", *wanted)
    if values["torque_enable"]:
        raise CorruptReplyError(f"servo {servo.number} keeps its torque: switch its supply off")
    differing = {name: raw for name, raw in wanted.items() if values[name] != raw}
    if differing.keys() & {"drive_mode", "operating_mode"}:
        store(bus, servo, "led", 0)
    for name, raw in differing.items():
        store(bus, servo, name, raw)


def cable_settings(servo: Servo, limit: float) -> dict[str, int]:
    """What a cable servo is set to beside its mode: its own limit (see own_limit) of the current."""
    if not servo.model.measures_current:
        return {}
    return {"current_limit": to_raw(servo["current_limit"], limit)}


def prepare_cable(bus: ServoBus, servo: Servo, limit: float) -> None:
    """As prepare, for a cable servo: extended position mode, and its own limit (see own_limit) of the current."""
    prepare(bus, servo, EXTENDED_POSITION_MODE, cable_settings(servo, limit))


def prepare_fin(bus: ServoBus, servo: Servo) -> None:
    """As prepare, for a fin servo: position mode."""
    prepare(bus, servo, POSITION_MODE)


def held_position(bus: ServoBus, servo: Servo, limit: float) -> int | None:
    """Where (ticks from home) a cable servo stands that an earlier driver left with its torque on; None for no such.

    Only one that is homed and set up as prepare_cable does; of another the position means nothing.
    """
    wanted = {
        "operating_mode": EXTENDED_POSITION_MODE,
        "drive_mode": 0,
        "led": 1,
        "torque_enable": 1,
    }
    wanted |= cable_settings(servo, limit)
    values = registers(bus, servo, *wanted, "present_position")
    return values["present_position"] if wanted.items() <= values.items() else None


def is_homed(bus: ServoBus, servo: Servo) -> bool:
    """Whether a cable servo's position 0 is the cable's home. Raises BusError."""
    return registers(bus, servo, "led")["led"] == 1


def home(bus: ServoBus, cables: Sequence[Servo]) -> None:
    """Makes the present positions of all cable servos 0, and marks them as homed. Torque must be off.

    The marks go out before anything else is written and come back after everything was read back: whatever fails, no
    servo is marked whose 0 is not the home. Raises HomingError: a servo did not take it; BusError: one does not answer.
    """
    for servo in cables:
        store(bus, servo, "led", 0)
    for servo in cables:
        _set_zero(bus, servo)
    for servo in cables:
        store(bus, servo, "led", 1)


def _set_zero(bus: ServoBus, servo: Servo) -> None:
    values = registers(bus, servo, "homing_offset", "present_position")
    offset = values["homing_offset"] - values["present_position"]
    if abs(offset) > _HOMING_OFFSET_LIMIT:
        raise HomingError(
            f"servo {servo.number} is too many turns from its encoder's zero: call the service reboot, "
            "which folds it to one turn, then home"
        )
    bus.write(servo.number, servo["homing_offset"], offset)
    values = registers(bus, servo, "homing_offset", "present_position")
    if values["homing_offset"] != offset or abs(values["present_position"]) > _HOME_TOLERANCE:
        raise HomingError(
            f"servo {servo.number} stands at {values['present_position']} ticks after homing, not at 0: "
            "was the robot moved? Call home again"
        )


def limit_motion(
    bus: ServoBus, servo: Servo, speed: float, watchdog: float, limit: float = 1.0
) -> None:
    """Sets what the servo itself keeps to once it is enabled: speed, output, and the bus watchdog.

    Args:
        servo: with its torque off, or left on by an earlier driver.
        speed: rad/s.
        watchdog: s without packets.
        limit: ratio of the load, see own_limit; means nothing where the servo measures its current.

    Raises:
        BusError: it does not answer, or refuses.
    """
    number, profile = servo.number, servo["profile_velocity"]
    bus.write(number, servo["bus_watchdog"], 0)  # one that has expired refuses all else
    bus.write(number, servo["bus_watchdog"], to_raw(servo["bus_watchdog"], watchdog))
    bus.write(number, profile, max(1, to_raw(profile, min(speed, servo.velocity_limit))))
    if not servo.model.measures_current:
        most = bus.read(number, servo["pwm_limit"])
        bus.write(number, servo["goal_pwm"], min(most, to_raw(servo["goal_pwm"], limit)))


def enable(bus: ServoBus, servo: Servo) -> int:
    """Torque on, after limit_motion has armed the bus watchdog; returns where (ticks) it holds.

    As short as can be: the servos that are enabled already wait for their first goal. Raises BusError where it
    does not answer, or refuses, and ConfigurationError where it restarted meanwhile: it has its torque without the
    limits then, and is to be disabled.
    """
    position = bus.read(servo.number, servo["present_position"])
    bus.write(servo.number, servo["goal_position"], position)
    bus.write(servo.number, servo["torque_enable"], 1)
    if not bus.read(servo.number, servo["bus_watchdog"]):
        raise ConfigurationError(
            f"servo {servo.number} restarted while it was set up: check its supply and its cable, then activate again"
        )
    return position


def disable(bus: ServoBus, servo: Servo) -> None:
    """Takes the torque off, and then disarms the bus watchdog. Raises BusError."""
    bus.write(servo.number, servo["torque_enable"], 0)
    bus.write(servo.number, servo["bus_watchdog"], 0)


def release_all(bus: ServoBus, servos: Sequence[Servo]) -> list[str]:
    """Takes the torque off every servo, whatever fails on the way, and looks whether it is.

    Returns:
        what failed, in words; empty when every servo says that its torque is off.
    """
    problems = []
    try:
        bus.torque_off_all()  # at once and without an answer; what follows makes sure
    except BusError as error:
        return [str(error)]
    with bus.patient(retries=2):
        for servo in servos:
            try:
                disable(bus, servo)
                if registers(bus, servo, "torque_enable")["torque_enable"]:
                    problems.append(f"servo {servo.number} says that its torque is on")
            except BusError as error:
                problems.append(str(error))
    return problems
