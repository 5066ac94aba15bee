# SPDX-License-Identifier: Apache-2.0
"""Offline runs of the virtual robot, many times faster than real time.

A run uses the servos, plant, sensor and camera of `VirtualRobot`, and commands the servos at 100 Hz through registers
instead of packets. Tests and benchmarks use such runs for hundreds of robots with random parameters.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_driver.servos.registers import COMMON
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import RobotSettings
from worm_driver.virtual_robot.wire import ina219_chip as ina219
from worm_msgs.gait import FORWARD
from worm_msgs.robot_parameters import RobotParameters

Array = NDArray[np.float64]

_PERIOD = 0.01  # s, time between two commands
_AVERAGING = 0x3DDF  # 32 V, 320 mV, each value the mean of 8 conversions of 12 bit, a pair of values every 8.5 ms
_TORQUE_ENABLE, _GOAL_POSITION, _POSITION = (
    COMMON[name] for name in ("torque_enable", "goal_position", "present_position")
)


@dataclass(frozen=True)
class Rehearsal:
    """Measurements of one run, and the true parameters. Times are in s from the start of the run.

    Attributes:
        onset: start of the gait.
        servo_time: times of goal_ticks and encoder_ticks, s.
        goal_ticks, encoder_ticks: goal and encoder position of the first cable servo relative to the start, ticks. Both
            increase with the contraction if the servo's sign is 1, and decrease if it is -1.
        tracker_time: times of the camera samples, s.
        rear_position, front_position: x1 and x2 of the camera samples, m; NaN while a marker is hidden.
        power_time: times at which the conversions of the power sensor were read, s.
        bus_voltage, current: values of the conversions, V and A.
        truth: true parameters of the robot.
    """

    onset: float
    servo_time: Array
    goal_ticks: Array
    encoder_ticks: Array
    tracker_time: Array
    rear_position: Array
    front_position: Array
    power_time: Array
    bus_voltage: Array
    current: Array
    truth: RobotParameters


def run_offline(
    settings: RobotSettings,
    command: Callable[[float], float],
    duration: float,
    rest: float = 2.0,
    direction: int = FORWARD,
) -> Rehearsal:
    """Simulate a run (a rest, then a command), and return its measurements.

    If the command does not begin at 0, as with pretension, the cable moves to the command's first value during the
    first half of the rest.

    Args:
        settings: the robot, with its seed.
        command: returns the commanded length change (m, negative for a contraction) at a time (s) since the onset.
        duration: duration of the command, s.
        rest: rest before the onset, s.
        direction: FORWARD or REVERSE of `worm_msgs.gait`.
    """
    fins = tuple(
        replace(fin, start_angle=fin.forward_angle if direction == FORWARD else fin.reverse_angle)
        for fin in settings.fin_servos
    )
    robot = VirtualRobot(replace(settings, fin_servos=fins))
    for servo in robot.servos:
        servo.write(_TORQUE_ENABLE.address, b"\x01")
    robot.chip.write(ina219.CONFIGURATION, _AVERAGING)
    first, homes = robot.servos[0], [servo.memory["goal_position"] for servo in robot.servos]
    goals: list[tuple[float, ...]] = []
    power: list[tuple[float, ...]] = []
    for index in range(round((rest + duration) / _PERIOD) + 1):
        time = index * _PERIOD
        robot.advance(time)
        change = command(time - rest) if time > rest else _tensioned(time, rest) * command(0.0)
        for item, servo, home in zip(settings.cable_servos, robot.servos, homes, strict=False):
            ticks = round(-item.sign * change / item.spool_radius * PULSES_PER_RADIAN)
            servo.write(_GOAL_POSITION.address, _GOAL_POSITION.pack(home + ticks))
        position = first.read(_POSITION.address, _POSITION.size)
        reached = _POSITION.unpack(position)
        goals.append((time, first.memory["goal_position"] - homes[0], reached - homes[0]))
        power += _power_sample(robot, time)
    seen = [(s.time, s.rear_position, s.front_position) for s in robot.take_samples()]
    servo_time, goal, encoder = np.array(goals).T
    tracker_time, rear, front = np.array(seen).T
    power_time, voltage, current = np.array(power).T
    truth = robot.plant.parameters
    return Rehearsal(
        rest,
        servo_time,
        goal,
        encoder,
        tracker_time,
        rear,
        front,
        power_time,
        voltage,
        current,
        truth,
    )


def _tensioned(time: float, rest: float) -> float:
    """Return the length change at a time (s) of the rest, divided by the length change at the onset.

    ``rest`` is the duration of the rest, s. The ratio increases from 0 to 1 as a half cosine in the first half of the
    rest.
    """
    return 0.5 * (1.0 - math.cos(math.pi * min(time / (0.5 * rest), 1.0))) if rest else 1.0


def _power_sample(robot: VirtualRobot, time: float) -> list[tuple[float, ...]]:
    """Return one row (time, bus voltage, current) if the sensor has a new conversion, else an empty list."""
    bus = robot.chip.read(ina219.BUS)
    if not bus & ina219.CONVERSION_READY:
        return []
    shunt = ina219.signed(robot.chip.read(ina219.SHUNT))
    robot.chip.read(ina219.POWER)  # clears the ready bit
    current = shunt * ina219.SHUNT_LSB / robot.settings.power_sensor.shunt
    return [(time, (bus >> 3) * ina219.BUS_LSB, current)]
