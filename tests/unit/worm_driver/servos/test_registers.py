# SPDX-License-Identifier: Apache-2.0
import itertools

import pytest

from worm_driver.servos.registers import COMMON, MODELS, XL430_W250, hardware_error_text
from worm_driver.servos.servo_state import STATE_SIZE, STATE_START
from worm_driver.virtual_robot.servo import control_table

MODEL_LIST = sorted(MODELS.values(), key=lambda model: model.number)


@pytest.mark.parametrize("model", MODEL_LIST, ids=lambda model: model.name)
def test_no_two_registers_overlap(model):
    rows = sorted(model.registers.values(), key=lambda row: row.address)
    for before, after in itertools.pairwise(rows):
        assert before.end <= after.address, (before, after)


@pytest.mark.parametrize("model", MODEL_LIST, ids=lambda model: model.name)
def test_the_table_agrees_with_the_one_written_for_the_virtual_robot(model):
    """Two people read the manual: address, size and sign of every row of both tables are the same."""
    other = next(m for m in control_table.MODELS.values() if m.number == model.number)
    for name, row in model.registers.items():
        found = other.registers[name]
        assert (row.address, row.size) == (found.address, found.size), name
        if row.signed != found.signed:
            assert name in {"goal_velocity", "goal_position"}, name


@pytest.mark.parametrize("model", MODEL_LIST, ids=lambda model: model.name)
def test_the_state_block_has_no_gap(model):
    rows = sorted(
        (
            row
            for row in model.registers.values()
            if STATE_START <= row.address < STATE_START + STATE_SIZE
        ),
        key=lambda row: row.address,
    )
    assert rows[0].address == STATE_START
    for before, after in itertools.pairwise(rows):
        assert before.end == after.address
    assert rows[-1].end == STATE_START + STATE_SIZE


def test_an_xl430_reports_a_load_and_no_current():
    assert not XL430_W250.measures_current
    assert "goal_current" not in XL430_W250.registers
    assert XL430_W250["present_load"].address == 126


def test_hardware_errors_are_named():
    assert hardware_error_text(0b100001) == "input voltage, overload"
    assert hardware_error_text(0b100) == "overheating"
    assert hardware_error_text(0b10) == "unknown fault 0x02"


def test_common_rows_are_in_every_model():
    for model in MODEL_LIST:
        for name, row in COMMON.items():
            assert model[name] == row
