# SPDX-License-Identifier: Apache-2.0
"""Motion of a servo's shaft: profile, position loop, speed limit, stall, back-driving.

Positions are in pulses of the shaft (4096 per turn, counted over all turns), speeds in pulses/s, torques in N*m. The
present point of the motor's profile is also called its trajectory, as in the e-manual.

The position of a motor is that of its shaft without load. A loaded shaft is behind it by the yield: position error that
the controller needs to hold the load.
"""

import math
from typing import NamedTuple

from worm_driver.virtual_robot.servo.control_table import PULSES_PER_TURN, VirtualServoModel

PULSES_PER_RADIAN = PULSES_PER_TURN / (2 * math.pi)

_POSITION_LOOP_TIME = 0.020  # s, position error divided by the speed that corrects it
_VELOCITY_LOOP_TIME = 0.006  # s, lag of the speed behind the commanded speed
_BREAKAWAY = 0.1  # friction of the gear, which a load must overcome, relative to the stall torque
_BACKDRIVE_SPEED = 2.0  # rad/s of the shaft, at a load of one stall torque above the gear friction
_STILL = 1e-3  # pulses and pulses/s; with a smaller error and speed, a motor at its goal is not integrated

LIMP = 0
POSITION = 1
VELOCITY = 2
BLOCKED = 3


class MotorState(NamedTuple):
    """Motion of the shaft, and the present point of the profile."""

    position: float
    velocity: float = 0.0
    trajectory_position: float = 0.0
    trajectory_velocity: float = 0.0


class MotorCommand(NamedTuple):
    """Motor command, computed from the registers.

    Attributes:
        kind: LIMP (torque off), POSITION, VELOCITY or BLOCKED (the shaft cannot turn).
        goal: pulses, or pulses/s for VELOCITY.
        acceleration, velocity: limits of the profile, pulses/s^2 and pulses/s; inf for none.
        speed_limit: limit by supply voltage and goal PWM, pulses/s.
        compliance: position error per load, pulses/(N*m). It is 0 for a controller with an integral part.
    """

    kind: int
    goal: float
    acceleration: float
    velocity: float
    speed_limit: float
    compliance: float = 0.0


class Yield(NamedTuple):
    """Distance (pulses) by which a loaded shaft is behind the position of its motor, and its rate (pulses/s)."""

    distance: float = 0.0
    rate: float = 0.0


def at_rest(position: float) -> MotorState:
    """Return the state of a motor at rest."""
    return MotorState(position, 0.0, position, 0.0)


def step(
    state: MotorState, command: MotorCommand, load: float, model: VirtualServoModel, step_s: float
) -> MotorState:
    """Return the state one step (s) later. A positive load (N*m) turns a limp shaft backward; a motor holds it."""
    kind, goal = command.kind, command.goal
    if kind == POSITION:
        if (
            abs(goal - state.position) < _STILL
            and abs(state.velocity) < _STILL
            and state.trajectory_position == goal
        ):
            return state
        position, velocity = _profile(state, command, step_s)
        wanted = velocity + (position - state.position) / _POSITION_LOOP_TIME
        return _turn(state, wanted, position, velocity, command.speed_limit, step_s)
    if kind == VELOCITY:
        velocity = _approach(state.trajectory_velocity, goal, command.acceleration * step_s)
        return _turn(state, velocity, state.position, velocity, command.speed_limit, step_s)
    if kind == BLOCKED:
        position, velocity = _profile(state, command, step_s)
        return MotorState(state.position, 0.0, position, velocity)
    velocity = _backdrive_velocity(load, model)
    position = state.position + velocity * step_s
    return MotorState(position, velocity, position, 0.0)


def step_yield(before: Yield, command: MotorCommand, load: float, step_s: float) -> Yield:
    """Return the yield one step (s) later. The position loop corrects a change of the load (N*m) only in part."""
    if command.kind == BLOCKED:
        return Yield(before.distance)
    rate = (command.compliance * load - before.distance) / _POSITION_LOOP_TIME
    return Yield(before.distance + rate * step_s, rate)


def _backdrive_velocity(load: float, model: VirtualServoModel) -> float:
    """Return the velocity (pulses/s) at which a load (N*m) turns a shaft without torque."""
    excess = abs(load) - _BREAKAWAY * model.stall_torque
    if excess <= 0:
        return 0.0
    speed = _BACKDRIVE_SPEED * excess / model.stall_torque * PULSES_PER_RADIAN
    return -math.copysign(speed, load)


def _profile(state: MotorState, command: MotorCommand, step_s: float) -> tuple[float, float]:
    """Return position and velocity of the trapezoidal profile one step later."""
    distance = command.goal - state.trajectory_position
    if command.velocity == math.inf and command.acceleration == math.inf:
        return command.goal, 0.0
    braking = command.velocity
    if command.acceleration != math.inf:
        braking = min(braking, math.sqrt(2 * command.acceleration * abs(distance)))
    velocity = _approach(
        state.trajectory_velocity, math.copysign(braking, distance), command.acceleration * step_s
    )
    if abs(distance) <= abs(velocity) * step_s:
        return command.goal, 0.0
    return state.trajectory_position + velocity * step_s, velocity


def _approach(value: float, target: float, most: float) -> float:
    return min(max(target, value - most), value + most)


def _turn(
    state: MotorState,
    wanted: float,
    trajectory_position: float,
    trajectory_velocity: float,
    speed_limit: float,
    step_s: float,
) -> MotorState:
    wanted = min(max(wanted, -speed_limit), speed_limit)
    velocity = state.velocity + (wanted - state.velocity) * step_s / _VELOCITY_LOOP_TIME
    return MotorState(
        state.position + velocity * step_s, velocity, trajectory_position, trajectory_velocity
    )
