# SPDX-License-Identifier: Apache-2.0
"""Runs of the virtual robot without a process, many times faster than real time.

The same servos, worm, sensor and camera as behind the bus, driven as a driver drives them at
100 Hz, but by register instead of by packet. For identification and for benchmarks, which need
hundreds of runs of robots with seeded parameters.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_driver.virtual_robot.camera import TrackerSample
from worm_driver.virtual_robot.plant import FORWARD, BodyParameters
from worm_driver.virtual_robot.servo.control_table import XM430_W350
from worm_driver.virtual_robot.servo.motor import PULSES_PER_RADIAN
from worm_driver.virtual_robot.servo.virtual_servo import Servo
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.virtual_settings import RobotSettings
from worm_driver.virtual_robot.wire.ina219_chip import BUS, CONFIGURATION, POWER, SHUNT

Array = NDArray[np.float64]

_PERIOD = 0.01  # s between commands
_AVERAGING = 0x1DDF  # 16 V, 320 mV, 8 samples of 12 bit each, continuous: a sample every 8.5 ms
_SHUNT_LSB = 10e-6  # V
_BUS_LSB = 4e-3  # V
_READY = 0x0002
_GOAL_POSITION = XM430_W350.registers["goal_position"]
_TORQUE_ENABLE = XM430_W350.registers["torque_enable"]


@dataclass(frozen=True)
class Run:
    """What the instruments of a lab saw of one run, and what was true. Times in s from its start.

    onset: when the gait began. servo_time, goal_ticks, encoder_ticks: the first cable servo, pulses
    from its start, positive as its sign says. tracker_time, rear_position, front_position: m, NaN
    while a marker is hidden. power_time, bus_voltage (V), current (A): fresh conversions only.
    truth: the parameters of the robot that ran.
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
    truth: BodyParameters


def sinusoid(stroke: float, frequency: float) -> Callable[[float], float]:
    """The gait (eq:problem_formulation_gait): length change (m) over time (s)."""
    return lambda time: -0.5 * stroke * (1.0 - math.cos(2.0 * math.pi * frequency * time))


def run_offline(
    settings: RobotSettings,
    command: Callable[[float], float],
    duration: float,
    rest: float = 2.0,
    direction: int = FORWARD,
) -> Run:
    """A run: a rest (s), then a command for a duration (s), then nothing more.

    command: length change (m) asked for at a time (s) since the onset, 0 at 0, contraction negative.
    direction: plant.FORWARD or plant.REVERSE. All else comes from the settings with their seed.
    """
    robot = VirtualRobot(_with_fins_set(settings, direction))
    for servo in robot.servos:
        servo.write(_TORQUE_ENABLE.address, b"\x01")
    robot.chip.write(CONFIGURATION, _AVERAGING)
    goals: list[tuple[float, int, int]] = []
    power: list[tuple[float, float, float]] = []
    homes = [servo.memory["goal_position"] for servo in robot.servos]
    steps = round((rest + duration) / _PERIOD)
    for index in range(steps + 1):
        time = index * _PERIOD
        robot.advance(time)
        change = command(time - rest) if time > rest else 0.0
        for item, servo, home in zip(settings.cable_servos, robot.servos, homes, strict=False):
            ticks = round(-item.sign * change / item.spool_radius * PULSES_PER_RADIAN)
            servo.write(_GOAL_POSITION.address, _GOAL_POSITION.encode(home + ticks))
        goals.append((time, *_cable_ticks(robot.servos[0], homes[0])))
        power += _power_sample(robot, time)
    return _collect(rest, goals, power, robot.take_samples(math.inf), robot)


def _with_fins_set(settings: RobotSettings, direction: int) -> RobotSettings:
    fins = tuple(
        replace(fin, start_angle=fin.forward_angle if direction == FORWARD else fin.reverse_angle)
        for fin in settings.fin_servos
    )
    return replace(settings, fin_servos=fins)


def _cable_ticks(servo: Servo, home: int) -> tuple[int, int]:
    """Goal and encoder from where the servo started."""
    row = XM430_W350.registers["present_position"]
    position = row.decode(servo.read(row.address, row.size))
    return servo.memory["goal_position"] - home, position - home


def _power_sample(robot: VirtualRobot, time: float) -> list[tuple[float, float, float]]:
    """Time, bus voltage and current of the sensor's conversion, if it is a new one."""
    bus = robot.chip.read(BUS)
    if not bus & _READY:
        return []
    shunt = robot.chip.read(SHUNT)
    robot.chip.read(POWER)  # clears the ready bit
    signed = shunt - 0x10000 if shunt & 0x8000 else shunt
    current = signed * _SHUNT_LSB / robot.settings.power_sensor.shunt
    return [(time, (bus >> 3) * _BUS_LSB, current)]


def _collect(
    onset: float,
    goals: list[tuple[float, int, int]],
    power: list[tuple[float, float, float]],
    samples: list[TrackerSample],
    robot: VirtualRobot,
) -> Run:
    servo_time, goal_ticks, encoder_ticks = np.array(goals, dtype=float).T
    power_time, bus_voltage, current = np.array(power, dtype=float).T
    rows = [(sample.time, sample.rear_position, sample.front_position) for sample in samples]
    tracker_time, rear, front = np.array(rows, dtype=float).T
    return Run(
        onset,
        servo_time,
        goal_ticks,
        encoder_ticks,
        tracker_time,
        rear,
        front,
        power_time,
        bus_voltage,
        current,
        robot.plant.parameters,
    )
