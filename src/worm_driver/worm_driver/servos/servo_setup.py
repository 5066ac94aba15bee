# SPDX-License-Identifier: Apache-2.0
"""Functions that identify, check, set up and release servos, outside of the control cycle.

A line is quiet if no late answer can arrive any more. A value on which a decision depends is read twice on a quiet
line, because a late answer must not pass for the answer to the present request. There are two exceptions. `identify`
pings only once. `standing_position` and `switch_on`, which belong to the switching on of the torque, do
not wait for a quiet line before each reading. All other written values are read back twice on a
quiet line, too. Callers should enter the context `ServoBus.retrying`; `release_all` enters it itself.

The home mark of a cable servo means that position 0 is the cable's home. It consists of led, which is 1, and of
velocity_i_gain, which is a function of homing_offset. Both registers are in RAM. A reboot or a power failure, which
reduce the position to a single turn, clear both, and a change of the operating mode resets the gain. A program that
lights the LED or changes the homing offset leaves no valid mark.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from worm_driver.driver_errors import BusError, ConfigurationError, CorruptReplyError, HomingError
from worm_driver.servos.registers import (
    EXTENDED_POSITION_MODE,
    MODELS,
    POSITION_MODE,
    Register,
    ServoModel,
    hardware_error_text,
)
from worm_driver.servos.servo_bus import Identity, ServoBus

#: Largest number of attempts to get two readings that agree.
_PAIRS = 4
#: Largest difference at which two readings of a register agree, raw, by register name; 0 for registers not listed here.
_UNSTEADY = {"present_position": 3, "present_input_voltage": 3}
#: Largest difference between two consecutive positions of a servo that stands still, ticks.
_STANDS = 64
#: Largest distance of a servo from 0 after homing, ticks. A robot that was just released still creeps.
_HOME_TOLERANCE = 10
#: Largest homing offset that the servos accept, ticks (e-manual, homing offset).
_HOMING_OFFSET_LIMIT = 1_044_479
#: Largest value of velocity_i_gain (e-manual). Position control does not use this gain.
_LARGEST_GAIN = 16_383

# Registers that need the same raw value in every robot, unless `ServoModel.factory` contains another one for the model.
# The driver writes the other registers that it needs with values that depend on the settings, see the functions.
#: Registers that must have this value already, with the reason.
_CHECKED = {
    "secondary_id": (255, "the servo would also obey commands for the servo with this id"),
    "temperature_limit": (80, "the servo protects itself at the factory value"),
    "pwm_limit": (885, "a lower value makes the servo slow and weak"),
    "shutdown": (52, "the servo protects itself at the factory value"),
}
#: Factory values of the limits of a position, ticks, and of the limits of the supply.
_POSITIONS = {"min_position_limit": 0, "max_position_limit": 4095, "homing_offset": 0}
_VOLTAGES = {"min_voltage_limit": 95, "max_voltage_limit": 160}
#: Registers of the EEPROM, written while the torque is off: a restarted servo then has no torque.
_EEPROM = {"return_delay_time": 0, "drive_mode": 0, "startup_configuration": 0}
#: Registers of the RAM. Gains are those of position control; the servo does not delay a goal.
_RAM = {
    "status_return_level": 2,
    "position_d_gain": 0,
    "position_i_gain": 0,
    "position_p_gain": 800,
    "feedforward_2nd_gain": 0,
    "feedforward_1st_gain": 0,
    "profile_acceleration": 0,
}


@dataclass(frozen=True)
class Servo:
    """Identified servo with the limits that it reports.

    Attributes:
        number: id on the bus.
        model: model with its control table.
        firmware: firmware version.
        velocity_limit: value of the register velocity_limit, or the factory value if this is less, rad/s.
        voltage_range: smallest and largest supply voltage that its registers allow, V.
        temperature_limit: temperature above which the servo shuts down, degC.
        position_range: smallest and largest goal of a fin servo, ticks.
    """

    number: int
    model: ServoModel
    firmware: int
    velocity_limit: float
    voltage_range: tuple[float, float]
    temperature_limit: float
    position_range: tuple[int, int]

    def __getitem__(self, name: str) -> Register:
        return self.model[name]


def identify(bus: ServoBus, number: int) -> Servo:
    """Ping a servo, make it answer all requests, and check the registers that need the same value in every robot."""
    identity = bus.ping(number)
    model = model_of(number, identity)
    require_watchdog(number, model, identity.firmware)
    answer_all(bus, number, model)
    servo, protections = read_servo(bus, number, model, identity.firmware)
    require_protections(servo, protections)
    return servo


def model_of(number: int, identity: Identity) -> ServoModel:
    """Return the model of a servo. Raises ConfigurationError if it is not supported."""
    model = MODELS.get(identity.model_number)
    if model is None:
        known = ", ".join(f"{m.name} ({m.number})" for m in MODELS.values())
        raise ConfigurationError(
            f"servo {number} has model number {identity.model_number}, which is not supported: use one of {known}"
        )
    return model


def require_watchdog(number: int, model: ServoModel, firmware: int) -> None:
    """Check that the firmware of a servo has a bus watchdog."""
    if firmware < model.minimum_firmware:
        raise ConfigurationError(
            f"servo {number} ({model.name}) has firmware {firmware}, which has no bus watchdog: "
            f"update it to {model.minimum_firmware} or later with Dynamixel Wizard"
        )


def answer_all(bus: ServoBus, number: int, model: ServoModel) -> None:
    """Make a servo answer all requests. It may be set to answer pings only, so the write must need no answer."""
    bus.sync_write(model["status_return_level"], {number: 2})


def read_servo(
    bus: ServoBus, number: int, model: ServoModel, firmware: int
) -> tuple[Servo, Mapping[str, int]]:
    """Return a servo with its limits, and its values for `require_protections`. Raises BusError."""
    limits = ("velocity_limit", "min_voltage_limit", "max_voltage_limit")
    ends = ("min_position_limit", "max_position_limit")
    values = _registers(bus, number, model, (*_CHECKED, *limits, *ends))
    values["velocity_limit"] = min(values["velocity_limit"], model.factory["velocity_limit"])
    speed, low, high = (model[name].from_raw(values[name]) for name in limits)
    temperature = model["temperature_limit"].from_raw(values["temperature_limit"])
    ticks = values[ends[0]], values[ends[1]]
    return Servo(number, model, firmware, speed, (low, high), temperature, ticks), values


def require_protections(servo: Servo, values: Mapping[str, int]) -> None:
    """Check the registers that need the same value in every robot, and that the driver does not write."""
    for name, raw in _protections(servo.model).items():
        if values[name] != raw:
            raise _unsuitable(servo.number, name, values[name], raw, _CHECKED[name][1])


def _protections(model: ServoModel) -> dict[str, int]:
    return _required(model, {name: raw for name, (raw, _) in _CHECKED.items()})


def new_limits(model: ServoModel) -> Mapping[str, int]:
    """Return the limits and protections of a new servo that suits every robot, raw EEPROM values by name."""
    current = {"current_limit": model.current_limit} if model.measures_current else {}
    speed = {"velocity_limit": model.factory["velocity_limit"]}
    return {**_POSITIONS, **current, **speed, **_required(model, _VOLTAGES), **_protections(model)}


def left_over(bus: ServoBus, servo: Servo, limit: float) -> str:
    """Return the values that another program left and that the driver will replace; empty if there are none.

    ``limit`` is that of `reset_control`.
    """
    wanted = _required(servo.model, {**_EEPROM, **_RAM})
    values = registers(bus, servo, *wanted, "goal_pwm")
    wanted["goal_pwm"] = max(values["goal_pwm"], servo["goal_pwm"].to_raw(limit))
    return _differences(values, wanted)


def _differences(values: Mapping[str, int], wanted: Mapping[str, int]) -> str:
    """Return the registers that have another value than wanted, as text; empty if there are none."""
    return ", ".join(
        f"{name} {values[name]} instead of {raw}"
        for name, raw in wanted.items()
        if values[name] != raw
    )


def _required(model: ServoModel, values: Mapping[str, int]) -> dict[str, int]:
    """Return the raw values, by name, that registers of a model need."""
    return {name: model.factory.get(name, raw) for name, raw in values.items()}


def _unsuitable(number: int, name: str, stored: int, needed: int, why: str) -> ConfigurationError:
    return ConfigurationError(
        f"servo {number} has {name} {stored} instead of {needed}: {why}. Set it to {needed} with setup_servo"
    )


def require_speed(servo: Servo, speed: float, parameter: str) -> None:
    """Check that a servo permits a speed (rad/s), or the speed that its model permits when new, if this is less."""
    register, factory = servo["velocity_limit"], servo.model.factory["velocity_limit"]
    needed = min(int(speed / register.scale), factory)
    stored = register.to_raw(servo.velocity_limit)
    if stored < needed:
        raise ConfigurationError(
            f"servo {servo.number} has velocity_limit {stored}, and {parameter} needs {needed}: set it to {factory} "
            "with setup_servo, or lower the parameter"
        )


def require_fin(bus: ServoBus, servo: Servo, low: int, high: int) -> None:
    """Check that a fin servo can reach its angles, ``low`` to ``high`` ticks, counted from its encoder's zero."""
    smallest, largest = servo.position_range
    if not smallest <= low <= high <= largest:
        raise ConfigurationError(
            f"servo {servo.number} has min_position_limit {smallest} and max_position_limit {largest}, but its fin "
            f"needs {low} to {high} ticks: set the limits to 0 and 4095 with setup_servo"
        )
    offset = registers(bus, servo, "homing_offset")["homing_offset"]
    if offset:
        why = "the angles of a fin count from its encoder's 0"
        raise _unsuitable(servo.number, "homing_offset", offset, 0, why)


def registers(bus: ServoBus, servo: Servo, *names: str) -> Mapping[str, int]:
    """Return raw values of registers by name. Two readings on a quiet line agree on them."""
    return _registers(bus, servo.number, servo.model, names)


def _registers(
    bus: ServoBus, number: int, model: ServoModel, names: Sequence[str]
) -> dict[str, int]:
    rows = [model[name] for name in names]
    start, end = min(row.address for row in rows), max(row.end for row in rows)

    def read() -> dict[str, int]:
        block = bus.read_block(number, start, end - start)
        return {row.name: row.unpack_from(block, start) for row in rows}

    for _ in range(_PAIRS):
        bus.require_quiet_line()
        first, second = read(), read()
        if all(abs(first[n] - second[n]) <= _UNSTEADY.get(n, 0) for n in names):
            return second
    raise CorruptReplyError(
        f"servo {number} returns different values of {', '.join(names)} in each answer"
    )


def store(bus: ServoBus, servo: Servo, name: str, raw: int) -> None:
    """Write a register and read it back."""
    _store_all(bus, servo, {name: raw})


def _store_all(bus: ServoBus, servo: Servo, wanted: Mapping[str, int]) -> None:
    """Write registers, then read them back together."""
    for name, raw in wanted.items():
        bus.write(servo.number, servo[name], raw)
    if wrong := _differences(registers(bus, servo, *wanted), wanted):
        raise CorruptReplyError(f"servo {servo.number} did not store a value: {wrong}. Try again")


def check(bus: ServoBus, servo: Servo) -> None:
    """Check that a servo's supply is in range and that it reports no fault."""
    values = registers(bus, servo, "hardware_error_status", "present_input_voltage")
    require_supply(servo, servo["present_input_voltage"].from_raw(values["present_input_voltage"]))
    require_no_error(servo, values["hardware_error_status"])


def require_supply(servo: Servo, voltage: float) -> None:
    """Check that the supply of a servo (V) is in the range of its registers."""
    low, high = servo.voltage_range
    if not low <= voltage <= high:
        raise ConfigurationError(
            f"servo {servo.number} ({servo.model.name}) has {voltage:.1f} V, outside its min_voltage_limit {low:.1f} V "
            f"to max_voltage_limit {high:.1f} V: check the supply and these registers"
        )


def require_no_error(servo: Servo, status: int) -> None:
    """Check that a servo's hardware_error_status is 0."""
    if status:
        raise ConfigurationError(
            f"servo {servo.number} reports {hardware_error_text(status)}: remove the cause, then switch its supply off "
            "and on, or call the driver's service reboot"
        )


def prepare(bus: ServoBus, servo: Servo, settings: Mapping[str, int]) -> None:
    """Switch the torque off and set up the EEPROM.

    The home mark is cleared before a change of the operating mode or the drive mode, because the servo then reduces
    its position to a single turn. Only values that differ are written, because the EEPROM wears out.

    Args:
        bus: servo bus.
        servo: the servo.
        settings: values of registers in addition to those of every robot, raw by name.
    """
    bus.write(servo.number, servo["torque_enable"], 0)
    wanted = {**_required(servo.model, _EEPROM), **settings}
    values = registers(bus, servo, "torque_enable", *wanted)
    if values["torque_enable"]:
        raise CorruptReplyError(f"servo {servo.number} keeps its torque: switch its supply off")
    differing = {name: raw for name, raw in wanted.items() if values[name] != raw}
    if differing.keys() & {"drive_mode", "operating_mode"}:
        store(bus, servo, "led", 0)
    for name, raw in differing.items():
        store(bus, servo, name, raw)


def _mode_and_current(servo: Servo, mode: int, limit: float) -> dict[str, int]:
    """Return the operating mode and, for a servo that measures its current, the current limit (A), raw by name."""
    if not servo.model.measures_current:
        return {"operating_mode": mode}
    return {"operating_mode": mode, "current_limit": servo["current_limit"].to_raw(limit)}


def prepare_cable(bus: ServoBus, servo: Servo, limit: float) -> None:
    """Prepare a cable servo: extended position mode, and a current limit (A, see `actuators.own_limit`)."""
    prepare(bus, servo, _mode_and_current(servo, EXTENDED_POSITION_MODE, limit))


def prepare_fin(bus: ServoBus, servo: Servo) -> None:
    """Prepare a fin servo: position mode, no homing offset, and the largest current limit."""
    settings = _mode_and_current(servo, POSITION_MODE, servo.model.strongest_current)
    prepare(bus, servo, {**settings, "homing_offset": 0})


def held_position(bus: ServoBus, servo: Servo) -> int | None:
    """Return the position (ticks from home) of a cable servo that was left with its torque on; None if it is off."""
    names = ("homing_offset", "operating_mode", "drive_mode", "led", "velocity_i_gain")
    values = registers(bus, servo, *names, "torque_enable", "present_position")
    if not values["torque_enable"]:
        return None
    wanted = {"operating_mode": EXTENDED_POSITION_MODE, "drive_mode": 0}
    wanted |= _mark(values["homing_offset"])
    if differing := _differences(values, wanted):
        raise ConfigurationError(
            f"servo {servo.number} has its torque on, and its position is not known ({differing}; led and "
            "velocity_i_gain are the mark of a homed servo): the body may be contracted, and would spring back without "
            "torque; switch the torque off with the program that switched it on, or secure the body and switch the "
            "supply off"
        )
    return values["present_position"]


def require_cable_settings(bus: ServoBus, servo: Servo, limit: float) -> None:
    """Check that a cable servo whose torque is on has the EEPROM of `prepare_cable`, which needs the torque off."""
    wanted = _required(servo.model, _EEPROM)
    wanted |= _mode_and_current(servo, EXTENDED_POSITION_MODE, limit)
    values = registers(bus, servo, *wanted)
    for name, raw in wanted.items():
        if values[name] != raw:
            stored, own = (servo[name].from_raw(each) for each in (values[name], raw))
            raise ConfigurationError(
                f"servo {servo.number} holds a contracted robot, and its {name} is {stored:g} instead of {own:g}, "
                "which can only be changed without torque: start the driver once more with the limits of the earlier "
                "driver, and bring the robot to rest (activate, deactivate)"
            )


def _mark(homing_offset: int) -> dict[str, int]:
    """Return the home mark of a cable servo with a homing offset (ticks), raw values by register name."""
    return {"velocity_i_gain": 1 + homing_offset % _LARGEST_GAIN, "led": 1}


def is_homed(bus: ServoBus, servo: Servo) -> bool:
    """Return True if a cable servo's position 0 is the cable's home."""
    values = registers(bus, servo, "homing_offset", "led", "velocity_i_gain")
    return _mark(values["homing_offset"]).items() <= values.items()


def home(bus: ServoBus, cables: Sequence[Servo]) -> None:
    """Set the present positions of all cable servos to 0 and mark the servos as homed. Their torque must be off.

    All home marks are cleared before any other write. They are set after the new zeros of all servos were read back. So
    a servo whose position 0 is not the home has no mark, also after a failure.
    """
    for servo in cables:
        store(bus, servo, "led", 0)
    offsets = [_set_zero(bus, servo) for servo in cables]
    for servo, offset in zip(cables, offsets, strict=True):
        for name, raw in _mark(offset).items():
            store(bus, servo, name, raw)


def _set_zero(bus: ServoBus, servo: Servo) -> int:
    """Set the present position to 0 and return the homing offset."""
    values = registers(bus, servo, "homing_offset", "present_position")
    offset = values["homing_offset"] - values["present_position"]
    if abs(offset) > _HOMING_OFFSET_LIMIT:
        raise HomingError(
            f"servo {servo.number} is too many turns from its encoder's zero: call the service reboot, "
            "which reduces its position to a single turn, then call home"
        )
    bus.write(servo.number, servo["homing_offset"], offset)
    values = registers(bus, servo, "homing_offset", "present_position")
    if values["homing_offset"] != offset or abs(values["present_position"]) > _HOME_TOLERANCE:
        raise HomingError(
            f"servo {servo.number} stands at {values['present_position']} ticks after homing, not at 0: "
            "was the robot moved? Call home again"
        )
    return offset


def reset_control(bus: ServoBus, servo: Servo, speed: float, limit: float = 1.0) -> None:
    """Write the registers that determine how a servo moves to a goal, and read them back. The watchdog is disarmed.

    Args:
        bus: servo bus.
        servo: servo whose torque is off, or was left on by an earlier driver.
        speed: speed limit, rad/s.
        limit: largest PWM output as a ratio of the maximum, see `actuators.own_limit`. Not used for a servo that
            measures its current.
    """
    bus.write(servo.number, servo["bus_watchdog"], 0)  # an expired watchdog lets no goal be written
    profile, output = servo["profile_velocity"], servo["goal_pwm"]
    wanted = {
        **_required(servo.model, _RAM),
        profile.name: max(1, profile.to_raw(min(speed, servo.velocity_limit))),
        output.name: output.to_raw(1.0 if servo.model.measures_current else limit),
    }
    _store_all(bus, servo, wanted)


def arm_watchdog(bus: ServoBus, servo: Servo, watchdog: float) -> None:
    """Set the time without packets (s) after which a servo with torque stops. Raises BusError."""
    register = servo["bus_watchdog"]
    bus.write(servo.number, register, register.to_raw(watchdog))


def standing_position(bus: ServoBus, servo: Servo) -> int:
    """Return the position of a servo (ticks) on which two consecutive readings agree within 64 ticks.

    A single wrong reading must not become a goal. The tolerance is not 0, because a body that springs back moves
    between two readings.
    """
    before = bus.read(servo.number, servo["present_position"])
    for _ in range(_PAIRS):
        position = bus.read(servo.number, servo["present_position"])
        if abs(position - before) <= _STANDS:
            return position
        before = position
    raise CorruptReplyError(
        f"servo {servo.number} reports a different position in each answer ({before} ticks in the last): check its "
        "cable and its encoder"
    )


def switch_on(bus: ServoBus, servo: Servo) -> None:
    """Switch the torque on.

    The bus watchdog must be armed (`arm_watchdog`), and the goal must be the present position. The function makes
    only two exchanges, because the servos that are already enabled wait for their first goal.
    """
    bus.write(servo.number, servo["torque_enable"], 1)
    if not bus.read(servo.number, servo["bus_watchdog"]):
        raise ConfigurationError(
            f"servo {servo.number} restarted while it was set up: check its supply and its cable, then activate again"
        )


def disable(bus: ServoBus, servo: Servo) -> None:
    """Switch the torque off, and then disarm the bus watchdog."""
    bus.write(servo.number, servo["torque_enable"], 0)
    bus.write(servo.number, servo["bus_watchdog"], 0)


def release_all(bus: ServoBus, servos: Sequence[Servo]) -> list[str]:
    """Switch the torque of every servo off, first by broadcast, then one by one with a check.

    A failure of one servo does not end the function. A failure of the broadcast does.

    Returns:
        Failures, one sentence each; empty if every servo reports that its torque is off.
    """
    problems = []
    try:
        bus.torque_off_all()  # Immediate, but not acknowledged. The loop below checks each servo.
    except BusError as error:
        return [str(error)]
    with bus.retrying(retries=2):
        for servo in servos:
            try:
                disable(bus, servo)
                if registers(bus, servo, "torque_enable")["torque_enable"]:
                    problems.append(f"servo {servo.number} reports that its torque is on")
            except BusError as error:
                problems.append(str(error))
    return problems
