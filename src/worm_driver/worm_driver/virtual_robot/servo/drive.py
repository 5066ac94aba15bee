# SPDX-License-Identifier: Apache-2.0
"""Between registers and motor: encoder, motor command, measured registers, protections."""

import math
from dataclasses import dataclass

from worm_driver.virtual_robot.servo import motor
from worm_driver.virtual_robot.servo.control_table import (
    CURRENT_MODE,
    PULSES_PER_TURN,
    PWM_MODE,
    VELOCITY_MODE,
    VirtualServoModel,
)
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN, MotorCommand, MotorState
from worm_driver.virtual_robot.servo.register_memory import RegisterMemory
from worm_msgs.servo_models import RPM

REVERSE_DRIVE = 0x01
TORQUE_ON_BY_GOAL = 0x08

INPUT_VOLTAGE_ERROR = 1 << 0
OVERHEATING_ERROR = 1 << 2
OVERLOAD_ERROR = 1 << 5

SPEED_UNIT = 0.229 / 60 * PULSES_PER_TURN  # pulses/s per raw unit of a velocity register
FULL_PWM = 885  # raw value of a PWM register at full output
_GAIN_UNIT = (
    1 / 128
)  # PWM units per pulse of position error, per raw unit of position_p_gain (e-manual)

# pulses/s^2 per raw unit of profile_acceleration
_ACCELERATION_UNIT = 214.577 / 3600 * PULSES_PER_TURN

_BLOCKED_ERROR = 0.2  # rad; following error at which a blocked motor reaches its strongest torque
_OVERLOAD_LEVEL = 0.9  # torque above which a servo is overloaded, relative to its strongest torque
_OVERLOAD_TIME = 1.0  # s; duration of an overload after which the servo reports it
_HEAT = 5.0  # degC; temperature of a servo above ambient


@dataclass
class Surroundings:
    """External conditions of a servo, set by the caller.

    Attributes:
        load: torque on the shaft, N*m; positive when it turns the shaft backward.
        voltage: supply voltage, V.
        ambient: ambient temperature, degC.
        blocked: True if the shaft cannot turn.
    """

    load: float = 0.0
    voltage: float = 12.0
    ambient: float = 25.0
    blocked: bool = False

    @property
    def voltage_raw(self) -> int:
        """Supply voltage in units of 0.1 V."""
        return max(round(self.voltage * 10), 0)

    @property
    def temperature(self) -> float:
        """Temperature of the servo, degC."""
        return self.ambient + _HEAT


@dataclass(frozen=True)
class Encoder:
    """Conversion between shaft position and position registers: reverse mode, folding, homing offset.

    Folding removes the whole turns from the position registers, for example when the servo boots. The shaft position
    continues to count all turns (unfolded).

    Attributes:
        direction: 1; -1 in reverse mode.
        folded_turns: number of turns that folding has removed.
        homing_offset: value of the register homing_offset, pulses.
    """

    direction: int
    folded_turns: int
    homing_offset: int

    def raw(self, shaft: float) -> int:
        """Return the register value for a shaft position (pulses, unfolded)."""
        counted = math.floor(self.direction * shaft) - self.folded_turns * PULSES_PER_TURN
        return counted + self.homing_offset

    def shaft(self, raw: int) -> float:
        """Return the centre of the range of shaft positions (pulses, unfolded) that have a register value."""
        counted = raw - self.homing_offset + self.folded_turns * PULSES_PER_TURN
        return self.direction * (counted + 0.5)


def turns_of(shaft: float, direction: int) -> int:
    """Return the number of turns that folding removes at a shaft position (pulses, unfolded)."""
    return math.floor(direction * shaft) // PULSES_PER_TURN


def direction_of(memory: RegisterMemory) -> int:
    """Return the direction in which the registers count: 1, or -1 in reverse mode (drive_mode)."""
    return -1 if memory["drive_mode"] & REVERSE_DRIVE else 1


def motor_command(
    memory: RegisterMemory, model: VirtualServoModel, voltage: float, goal: float
) -> MotorCommand:
    """Return the motor command for the present registers.

    Args:
        memory: registers of the servo.
        model: servo model.
        voltage: supply voltage, V.
        goal: shaft position of the goal, pulses.
    """
    full_speed = _full_speed(model, voltage)
    speed = _speed_goal(memory, full_speed)
    kind = motor.POSITION if speed is None else motor.VELOCITY
    return MotorCommand(
        kind if memory["torque_enable"] else motor.LIMP,
        goal if speed is None else speed,
        memory["profile_acceleration"] * _ACCELERATION_UNIT or math.inf,
        memory["profile_velocity"] * SPEED_UNIT or math.inf,
        full_speed * min(abs(memory["goal_pwm"]), memory["pwm_limit"]) / FULL_PWM,
        _compliance(memory, model) if memory["torque_enable"] and speed is None else 0.0,
    )


def _full_speed(model: VirtualServoModel, voltage: float) -> float:
    """Return the no-load speed at a voltage (V), pulses/s."""
    return model.no_load_speed * RPM * voltage / model.nominal_voltage * PULSES_PER_RADIAN


def _speed_goal(memory: RegisterMemory, full_speed: float) -> float | None:
    """Return the commanded speed, pulses/s; None if the motor controls its position.

    The motor controls its position in the position modes and, after the Bus Watchdog has fired, in all modes. The
    driver uses no other mode: a servo on which another program left one turns away when its torque goes on.
    """
    if memory["bus_watchdog"] < 0:
        return None
    direction = direction_of(memory)
    mode = memory["operating_mode"]
    if mode == VELOCITY_MODE:
        return direction * memory["goal_velocity"] * SPEED_UNIT
    if mode == PWM_MODE:
        return direction * memory["goal_pwm"] / FULL_PWM * full_speed
    if mode == CURRENT_MODE:
        current = memory["goal_current"]
        return direction * math.copysign(full_speed, current) if current else 0.0
    return None


def _compliance(memory: RegisterMemory, model: VirtualServoModel) -> float:
    """Return the position error per load of the position controller, pulses/(N*m).

    Without an integral part the controller holds a load only by an error: the PWM output is the P gain times the error,
    and full output holds the stall torque. With the factory gain 800, full output needs an error of 142 pulses. On an
    XM430 with a spool of 25 mm this is 3.3 mm of cable per 100 N. The friction of the gear is neglected.
    """
    if memory["position_i_gain"]:
        return 0.0
    gain = max(memory["position_p_gain"], 1) * _GAIN_UNIT
    return FULL_PWM / gain / model.stall_torque


def _strongest_torque(memory: RegisterMemory, model: VirtualServoModel) -> float:
    """Return the motor's largest torque, N*m."""
    if "current_limit" not in memory:
        return model.stall_torque
    limit = memory["current_limit"] * model.current_unit * model.torque_constant
    return min(limit, model.stall_torque)


def motor_torque(
    command: MotorCommand,
    position: float,
    around: Surroundings,
    memory: RegisterMemory,
    model: VirtualServoModel,
) -> float:
    """Return the motor torque, N*m; positive when it acts forward, against the load or the obstacle.

    ``position`` is that of the shaft, pulses.
    """
    if command.kind == motor.LIMP:
        return 0.0
    if not around.blocked:
        return around.load
    strongest = _strongest_torque(memory, model)
    if command.kind == motor.VELOCITY:
        return math.copysign(strongest, command.goal) if command.goal else 0.0
    error = (command.goal - position) / PULSES_PER_RADIAN
    return min(max(error / _BLOCKED_ERROR, -1.0), 1.0) * strongest


def is_overloaded(torque: float, memory: RegisterMemory, model: VirtualServoModel) -> bool:
    """Return True if a torque (N*m) overloads the servo."""
    return abs(torque) >= _OVERLOAD_LEVEL * _strongest_torque(memory, model)


def alerts(memory: RegisterMemory, around: Surroundings, overload: float) -> int:
    """Return the bits of Hardware Error Status that the surroundings and an overload of a duration (s) set."""
    bits = 0
    if not memory["min_voltage_limit"] <= around.voltage_raw <= memory["max_voltage_limit"]:
        bits |= INPUT_VOLTAGE_ERROR
    if around.temperature > memory["temperature_limit"]:
        bits |= OVERHEATING_ERROR
    if overload >= _OVERLOAD_TIME:
        bits |= OVERLOAD_ERROR
    return bits


def motion_registers(encoder: Encoder, state: MotorState) -> dict[str, int]:
    """Return the raw values of the registers that report motion."""
    return {
        "present_velocity": encoder.direction * round(state.velocity / SPEED_UNIT),
        "present_position": encoder.raw(state.position),
        "position_trajectory": encoder.raw(state.trajectory_position),
    }


def torque_register(
    memory: RegisterMemory, model: VirtualServoModel, torque: float, noise: float
) -> dict[str, int]:
    """Return the raw value of the register that reports the torque.

    Args:
        memory: registers of the servo.
        model: servo model.
        torque: motor torque, N*m.
        noise: measurement noise, raw units of Present Current or Present Load.
    """
    signed = direction_of(memory) * torque
    if model.measures_current:
        counts = signed / model.torque_constant / model.current_unit + noise
        return {"present_current": round(min(max(counts, -32767), 32767))}
    share = signed / model.stall_torque
    return {"present_load": round(min(max(share * 1000 + noise, -1000), 1000))}
