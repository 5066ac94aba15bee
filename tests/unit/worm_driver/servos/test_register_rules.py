# SPDX-License-Identifier: Apache-2.0
"""Servos whose registers another program has changed, byte for byte.

Whatever a program left: the driver resets it, or rejects it with servo, register and value, or the robot moves as
usual.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache

import numpy as np
import pytest
from driver_rig import CABLE, Rig, instruction_packet, rig_of_model

from worm_driver.driver_errors import DriverError
from worm_driver.gait.gait_player import Phase
from worm_driver.virtual_robot.servo.control_table import MODELS, VirtualServoModel
from worm_driver.virtual_robot.wire.packet import Instruction

FIN = 11
#: registers by which a servo is found
FOUND_BY = ("id", "baud_rate", "protocol_type")
#: registers that mark a cable servo as homed
HOME_MARK = ("led", "velocity_i_gain")
#: the servos of the paper's robot; all other combinations are for the night
BY_DAY = {("XM430-W350", CABLE), ("XL430-W250", FIN)}
#: registers that the driver checks; it may also reset a value, or move as usual with it
CHECKED = {
    *("id", "baud_rate", "secondary_id", "protocol_type", "homing_offset", "temperature_limit"),
    *("max_voltage_limit", "min_voltage_limit", "pwm_limit", "velocity_limit", "shutdown"),
    *("max_position_limit", "min_position_limit"),
}
#: registers without an effect on the driver; it resets all others
IRRELEVANT = {"moving_threshold", "velocity_p_gain", "goal_current", "goal_velocity"}


@cache
def closed(name: str) -> Rig:
    """Return a homed robot of one model, with a cable servo and a fin servo, whose driver has ended."""
    rig = rig_of_model(MODELS[name], max_servo_current=5.0)
    rig.activate()
    rig.run(0.1)
    assert rig.end() == []
    return rig


def write(rig: Rig, servo: int, name: str, value: int) -> bool:
    """Write a register as another program does. Return True if the servo accepts and stores the value."""
    target = next(each for each in rig.virtual.servos if each.servo_id == servo)
    row = target.model.registers[name]
    data = row.address.to_bytes(2, "little") + row.pack(value)
    before = target.memory[name]
    rig.virtual.receive(instruction_packet(servo, Instruction.WRITE, data), rig.clock.now)
    return target.memory[name] == value != before


def registers(rig: Rig) -> Mapping[tuple[int, str], int]:
    """Return the raw values of all writable registers but the goal, by index of the servo and name.

    The driver writes the goal in every cycle. A loaded servo yields, so two activations hold it at different goals.
    """
    return {
        (index, name): servo.memory[name]
        for index, servo in enumerate(rig.virtual.servos)
        for name, row in servo.model.registers.items()
        if row.writable and name != "goal_position"
    }


def motion(rig: Rig) -> np.ndarray:
    """Return the positions (ticks) of the cable servo in a gait backwards, and that of the fin at its end."""
    rig.positions.clear()
    rig.start(0.02, 0.4, cycles=1, direction=-1)
    rig.run(10.0, until=lambda s: s.player.phase is not Phase.IDLE)
    rig.run(10.0, until=lambda s: s.player.phase in (Phase.IDLE, Phase.FAULT))
    return np.array([*(at for _, at in rig.positions), rig.virtual.servos[1].motor.position])


@cache
def healthy(model: str) -> tuple[Mapping[tuple[int, str], int], np.ndarray]:
    """Return the registers after an activation, and the motion of a gait, of a robot that nobody changed."""
    rig = closed(model).copy().restarted_driver()
    rig.activate()
    return registers(rig), motion(rig)


def left_over(model: VirtualServoModel, name: str) -> Iterator[int]:
    row = model.registers[name]
    usual = row.initial
    values = {min(row.low, -1), row.high, usual + 1}
    yield from sorted(value for value in values if row.low <= value <= row.high)


def activated(rig: Rig) -> Rig | DriverError:
    """Return the next driver on the robot, activated, or the reason why there is none."""
    try:
        again = rig.restarted_driver()
        again.activate()
    except DriverError as error:
        return error
    return again


def as_homed_here(
    found: Mapping[tuple[int, str], int], expected: Mapping[tuple[int, str], int]
) -> Mapping[tuple[int, str], int]:
    """Return registers with the expected home, if a servo was homed again where its load had turned it.

    A loaded servo without torque stands up to 30 ticks from the home that it had.
    """
    offset, mark = (0, "homing_offset"), (0, "velocity_i_gain")
    moved = found[offset] - expected[offset]
    if abs(moved) <= 30 and found[mark] - expected[mark] == moved:
        return {**found, offset: expected[offset], mark: expected[mark]}
    return found


def judge(rig: Rig, model: VirtualServoModel, servo: int, name: str, value: int) -> str:
    """Return what the driver does with a value that another program left; fail if the driver does nothing useful."""
    again = activated(rig)
    if isinstance(again, DriverError):
        stored = f"{value / 10:.1f}" if name.endswith("voltage_limit") else f"{value}"
        named = "does not answer" if name in FOUND_BY else f"{name}( is)? {stored}\\b"
        assert re.match(f"servo {servo} .*{named}", str(again)), (name, value, again)
        return "rejected"
    expected, usual = healthy(model.name)
    if as_homed_here(registers(again), expected) == expected:
        return "reset"
    np.testing.assert_allclose(motion(again), usual, atol=3.0, err_msg=f"{name} {value}")
    return "irrelevant"


@pytest.mark.parametrize(
    ("model", "servo"),
    [
        pytest.param(
            model, servo, marks=[] if (model.name, servo) in BY_DAY else [pytest.mark.night]
        )
        for model in MODELS.values()
        for servo in (CABLE, FIN)
    ],
)
def test_whatever_a_program_left_is_reset_rejected_or_irrelevant(model, servo):
    tried = 0
    for name, row in model.registers.items():
        if not row.writable:
            continue
        for value in left_over(model, name):
            rig = closed(model.name).copy()
            if write(rig, servo, name, value):
                tried += 1
                outcome = judge(rig, model, servo, name, value)
                if name not in CHECKED:
                    unused = name in IRRELEVANT or (name in HOME_MARK and servo == FIN)
                    assert outcome == ("irrelevant" if unused else "reset"), (name, value)
    assert tried > 40
