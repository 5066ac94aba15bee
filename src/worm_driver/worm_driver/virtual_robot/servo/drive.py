# SPDX-License-Identifier: Apache-2.0
"""Conversion of servo registers to motor commands."""

import math

from worm_driver.virtual_robot.servo import motor
from worm_driver.virtual_robot.servo.control_table import (
    CURRENT_MODE,
    CURRENT_POSITION_MODE,
    PULSES_PER_TURN,
    PWM_MODE,
    VELOCITY_MODE,
    VirtualServoModel,
)
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN, MotorCommand
from worm_driver.virtual_robot.servo.register_memory import RegisterMemory

REVERSE_DRIVE = 0x01
TIME_BASED_PROFILE = 0x04
TORQUE_ON_BY_GOAL = 0x08

SPEED_UNIT = 0.229 / 60 * PULSES_PER_TURN  # pulses/s per raw unit of a velocity register
FULL_PWM = 885  # raw value of a PWM register at full output
_GAIN_UNIT = (
    1 / 128
)  # PWM units per pulse of position error, per raw unit of position_p_gain (e-manual)

# pulses/s^2 per raw unit of profile_acceleration
_ACCELERATION_UNIT = 214.577 / 3600 * PULSES_PER_TURN


def direction_of(memory: RegisterMemory) -> int:
    """Return the direction in which the registers count: 1, or -1 in reverse mode (drive_mode)."""
    return -1 if memory["drive_mode"] & REVERSE_DRIVE else 1


def motor_command(
    memory: RegisterMemory, model: VirtualServoModel, voltage: float, goal: float, planned: float
) -> MotorCommand:
    """Return the motor command for the present registers.

    Args:
        memory: registers of the servo.
        model: servo model.
        voltage: supply voltage, V.
        goal: shaft position of the goal, pulses.
        planned: present position of the profile, pulses. A time-based profile starts there.
    """
    full_speed = _full_speed(model, voltage)
    speed = _speed_goal(memory, full_speed)
    kind = motor.POSITION if speed is None else motor.VELOCITY
    acceleration, velocity = _profile(memory, abs(goal - planned))
    return MotorCommand(
        kind if memory["torque_enable"] else motor.LIMP,
        goal if speed is None else speed,
        acceleration,
        velocity,
        full_speed * min(abs(memory["goal_pwm"]), memory["pwm_limit"]) / FULL_PWM,
        _torque_limit(memory, model),
        _compliance(memory, model) if memory["torque_enable"] and speed is None else 0.0,
    )


def _full_speed(model: VirtualServoModel, voltage: float) -> float:
    """Return the no-load speed at a voltage (V), pulses/s."""
    return model.no_load_speed * voltage / model.nominal_voltage * PULSES_PER_RADIAN


def _speed_goal(memory: RegisterMemory, full_speed: float) -> float | None:
    """Return the commanded speed, pulses/s; None if the motor controls its position.

    The motor controls its position in the position modes and, after the Bus Watchdog has fired, in all modes.
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


def _torque_limit(memory: RegisterMemory, model: VirtualServoModel) -> float:
    """Return the torque limit set by the goal current, N*m; inf in modes without current control."""
    if memory["operating_mode"] not in (CURRENT_MODE, CURRENT_POSITION_MODE):
        return math.inf
    return abs(memory["goal_current"]) * model.current_unit * model.torque_constant


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


def _profile(memory: RegisterMemory, distance: float) -> tuple[float, float]:
    """Return acceleration (pulses/s^2) and velocity (pulses/s) of a profile over a distance (pulses); inf: no limit."""
    velocity, acceleration = memory["profile_velocity"], memory["profile_acceleration"]
    if memory["drive_mode"] & TIME_BASED_PROFILE:  # The registers contain duration and ramp in ms.
        if velocity == 0:
            return math.inf, math.inf
        ramp = min(acceleration, velocity / 2) * 1e-3
        speed = distance / (velocity * 1e-3 - ramp)
        return (speed / ramp if ramp > 0 else math.inf), speed
    return acceleration * _ACCELERATION_UNIT or math.inf, velocity * SPEED_UNIT or math.inf
