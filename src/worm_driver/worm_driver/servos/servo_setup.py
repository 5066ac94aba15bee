# SPDX-License-Identifier: Apache-2.0
"""One servo at a time: who is it, is it fit, and setting it up. Used outside of the 100 Hz cycle.

The led register of a cable servo is the mark of its home: lit while the turn count is valid. It is RAM, so a reboot
or a power cut, which fold the turn count, put it out, whoever was watching.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from worm_driver.control.supervision import Limits
from worm_driver.errors import BusError, ConfigurationError, HomingError
from worm_driver.servos.encoding import from_raw, to_raw
from worm_driver.servos.registers import (
    EXTENDED_POSITION_MODE,
    MODELS,
    POSITION_MODE,
    Register,
    ServoModel,
    hardware_error_text,
)
from worm_driver.servos.servo_bus import ServoBus

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

    Raises:
        BusError: it does not answer.
        ConfigurationError: it has no control table here, or too old a firmware.
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

    def value(name: str) -> float:
        return from_raw(model[name], bus.read(number, model[name]))

    return Servo(
        number,
        model,
        identity.firmware,
        value("velocity_limit"),
        (value("min_voltage_limit"), value("max_voltage_limit")),
        value("temperature_limit"),
    )


def check(bus: ServoBus, servo: Servo) -> None:
    """Raises ConfigurationError when a servo reports a fault, or its supply is out of range."""
    status = bus.read(servo.number, servo["hardware_error_status"])
    if status:
        raise ConfigurationError(
            f"servo {servo.number} reports {hardware_error_text(status)}: mend the cause, then call the "
            "service reboot"
        )
    register = servo["present_input_voltage"]
    voltage = from_raw(register, bus.read(servo.number, register))
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
    written, as the EEPROM wears.

    Args:
        bus: where the servo is.
        servo: to be set up.
        mode: operating mode.
        settings: further registers by name, raw.
    """
    bus.write(servo.number, servo["torque_enable"], 0)
    bus.write(servo.number, servo["status_return_level"], 2)
    wanted = {"return_delay_time": 0, "drive_mode": 0, "operating_mode": mode, **settings}
    for name, raw in wanted.items():
        if bus.read(servo.number, servo[name]) != raw:
            bus.write(servo.number, servo[name], raw)
            if name in ("drive_mode", "operating_mode"):
                bus.write(servo.number, servo["led"], 0)


def prepare_cable(bus: ServoBus, servo: Servo, limit: float) -> None:
    """As prepare, for a cable servo: extended position mode, and its own limit (see own_limit) of the current."""
    settings = {}
    if servo.model.measures_current:
        settings["current_limit"] = to_raw(servo["current_limit"], limit)
    prepare(bus, servo, EXTENDED_POSITION_MODE, settings)


def prepare_fin(bus: ServoBus, servo: Servo) -> None:
    """As prepare, for a fin servo: position mode."""
    prepare(bus, servo, POSITION_MODE)


def is_homed(bus: ServoBus, servo: Servo) -> bool:
    """Whether a cable servo's position 0 is the cable's home. Raises BusError."""
    return bus.read(servo.number, servo["led"]) == 1


def home(bus: ServoBus, servo: Servo) -> None:
    """Makes the present position of a cable servo 0, and marks it as homed. Torque must be off.

    Raises:
        HomingError: the servo did not take it.
        BusError: it does not answer.
    """
    offset_register, position_register = servo["homing_offset"], servo["present_position"]
    offset = bus.read(servo.number, offset_register)
    offset -= bus.read(servo.number, position_register)
    if abs(offset) > _HOMING_OFFSET_LIMIT:
        raise HomingError(
            f"servo {servo.number} is too many turns from its encoder's zero: call the service reboot, "
            "which folds it to one turn, then home"
        )
    bus.write(servo.number, offset_register, offset)
    position = bus.read(servo.number, position_register)
    if abs(position) > 3:
        raise HomingError(f"servo {servo.number} stands at {position} ticks after homing, not at 0")
    bus.write(servo.number, servo["led"], 1)


def limit_motion(bus: ServoBus, servo: Servo, speed: float, limit: float = 1.0) -> None:
    """Sets what the servo itself keeps to once it is enabled; disarms the bus watchdog, which would refuse it.

    Args:
        bus: where the servo is.
        servo: with its torque off.
        speed: rad/s.
        limit: ratio of the load, see own_limit; means nothing where the servo measures its current.

    Raises:
        BusError: it does not answer, or refuses.
    """
    number, profile = servo.number, servo["profile_velocity"]
    bus.write(number, servo["bus_watchdog"], 0)
    bus.write(number, profile, max(1, to_raw(profile, min(speed, servo.velocity_limit))))
    if not servo.model.measures_current:
        most = bus.read(number, servo["pwm_limit"])
        bus.write(number, servo["goal_pwm"], min(most, to_raw(servo["goal_pwm"], limit)))


def enable(bus: ServoBus, servo: Servo, watchdog: float) -> None:
    """Torque on, holding the present position, with the bus watchdog (s without packets) armed. Raises BusError.

    As short as can be: the servos that are enabled already wait for their first goal.
    """
    number, register = servo.number, servo["bus_watchdog"]
    position = bus.read(number, servo["present_position"])
    bus.write(number, servo["goal_position"], position)
    bus.write(number, servo["torque_enable"], 1)
    bus.write(number, register, to_raw(register, watchdog))


def disable(bus: ServoBus, servo: Servo) -> None:
    """Disarms the bus watchdog and takes the torque off. Raises BusError."""
    bus.write(servo.number, servo["bus_watchdog"], 0)
    bus.write(servo.number, servo["torque_enable"], 0)


def release_all(bus: ServoBus, servos: tuple[Servo, ...]) -> list[str]:
    """Takes the torque off every servo, whatever fails on the way.

    Returns:
        what failed, in words; empty when every servo has acknowledged.
    """
    problems = []
    try:
        bus.torque_off_all()  # at once and without an answer; what follows makes sure
    except BusError as error:
        return [str(error)]
    for servo in servos:
        try:
            disable(bus, servo)
        except BusError as error:
            problems.append(str(error))
    return problems
