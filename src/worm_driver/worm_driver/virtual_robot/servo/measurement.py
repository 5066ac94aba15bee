# SPDX-License-Identifier: Apache-2.0
"""Measured registers of a servo, and its protections."""

import math
from dataclasses import dataclass

from worm_driver.virtual_robot.servo import motor
from worm_driver.virtual_robot.servo.control_table import VirtualServoModel
from worm_driver.virtual_robot.servo.drive import FULL_PWM, SPEED_UNIT, direction_of
from worm_driver.virtual_robot.servo.encoder import Encoder
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN, MotorCommand, MotorState
from worm_driver.virtual_robot.servo.register_memory import RegisterMemory

INPUT_VOLTAGE_ERROR = 1 << 0
OVERHEATING_ERROR = 1 << 2
OVERLOAD_ERROR = 1 << 5

_IN_POSITION = 20  # pulses; distance from the goal within which Moving Status reports the arrival
_BLOCKED_ERROR = 0.2  # rad; following error at which a blocked motor reaches its strongest torque
_OVERLOAD_LEVEL = 0.9  # torque above which a servo is overloaded, relative to its strongest torque
_OVERLOAD_TIME = 1.0  # s; duration of an overload after which the servo reports it
_HEATING_TIME = 300.0  # s; time constant of the temperature
_IDLE_HEAT = 5.0  # degC; rise above ambient without torque
_STALL_HEAT = 20.0  # degC; further rise at the stall torque


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


@dataclass(frozen=True)
class Wear:
    """Thermal and overload state.

    Attributes:
        heat: temperature rise above ambient, degC.
        overload: duration of the present overload, s.
    """

    heat: float = _IDLE_HEAT
    overload: float = 0.0


def strongest_torque(memory: RegisterMemory, model: VirtualServoModel) -> float:
    """Return the motor's largest torque, N*m."""
    if "current_limit" not in memory:
        return model.stall_torque
    limit = memory["current_limit"] * model.current_unit * model.torque_constant
    return min(limit, model.stall_torque)


def motor_torque(
    command: MotorCommand, state: MotorState, around: Surroundings, strongest: float
) -> float:
    """Return the motor torque, N*m; positive when it acts forward, against the load or the obstacle."""
    if command.kind == motor.LIMP:
        return 0.0
    if not around.blocked:
        return around.load
    if command.kind == motor.VELOCITY:
        return math.copysign(strongest, command.goal) if command.goal else 0.0
    error = (command.goal - state.position) / PULSES_PER_RADIAN
    return min(max(error / _BLOCKED_ERROR, -1.0), 1.0) * strongest


def supervise(
    wear: Wear,
    torque: float,
    memory: RegisterMemory,
    model: VirtualServoModel,
    around: Surroundings,
    duration: float,
) -> tuple[Wear, int]:
    """Return the wear after a duration (s) with a torque (N*m), and the bits of Hardware Error Status that it sets."""
    heating = _IDLE_HEAT + _STALL_HEAT * (torque / model.stall_torque) ** 2
    heat = wear.heat + (heating - wear.heat) * min(duration / _HEATING_TIME, 1.0)
    overloaded = abs(torque) >= _OVERLOAD_LEVEL * strongest_torque(memory, model)
    wear = Wear(heat, wear.overload + duration if overloaded else 0.0)
    bits = 0
    voltage = voltage_raw(around)
    if not memory["min_voltage_limit"] <= voltage <= memory["max_voltage_limit"]:
        bits |= INPUT_VOLTAGE_ERROR
    if around.ambient + heat > memory["temperature_limit"]:
        bits |= OVERHEATING_ERROR
    if wear.overload >= _OVERLOAD_TIME:
        bits |= OVERLOAD_ERROR
    return wear, bits


def voltage_raw(around: Surroundings) -> int:
    """Return the supply voltage in units of 0.1 V."""
    return max(round(around.voltage * 10), 0)


def motion_registers(
    memory: RegisterMemory, encoder: Encoder, state: MotorState, command: MotorCommand
) -> dict[str, int]:
    """Return the raw values of the registers that report motion."""
    direction = encoder.direction
    velocity = direction * round(state.velocity / SPEED_UNIT)
    return {
        "present_velocity": velocity,
        "present_position": encoder.raw(state.position),
        "velocity_trajectory": direction * round(state.trajectory_velocity / SPEED_UNIT),
        "position_trajectory": encoder.raw(state.trajectory_position),
        "moving": int(abs(velocity) > memory["moving_threshold"]),
        "moving_status": _moving_status(state, command),
    }


def torque_registers(
    memory: RegisterMemory, model: VirtualServoModel, torque: float, noise: float
) -> dict[str, int]:
    """Return the raw values of the registers that report the torque.

    Args:
        memory: registers of the servo.
        model: servo model.
        torque: motor torque, N*m.
        noise: measurement noise, raw units of Present Current or Present Load.
    """
    signed = direction_of(memory) * torque
    share = signed / model.stall_torque
    registers = {"present_pwm": round(min(max(share, -1.0), 1.0) * FULL_PWM)}
    if "present_current" in memory:
        counts = signed / model.torque_constant / model.current_unit + noise
        registers["present_current"] = round(min(max(counts, -32767), 32767))
    else:
        registers["present_load"] = round(min(max(share * 1000 + noise, -1000), 1000))
    return registers


def _moving_status(state: MotorState, command: MotorCommand) -> int:
    if command.kind != motor.POSITION:
        return 0
    arrived = abs(command.goal - state.position) <= _IN_POSITION
    ongoing = state.trajectory_position != command.goal
    profile = 0x30 if command.velocity != math.inf else 0
    return int(arrived) | int(ongoing) << 1 | profile
