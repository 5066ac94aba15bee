# SPDX-License-Identifier: Apache-2.0
"""A run as one table."""

import dataclasses
import sys

import numpy as np
import pytest
from recorded_run import GAIT, REST_S, simulated_run
from virtual_session import joined_session

from worm_model.analysis.run_table import run_table
from worm_model.errors import InputError
from worm_model.run import JointSamples

RUN = simulated_run(cycles=2)


def test_every_sample_is_there_once_at_its_moment():
    columns = run_table(RUN).columns
    for name, samples, values in (
        ("x1_m", RUN.tracker, RUN.tracker.rear_position),
        ("power_W", RUN.power, RUN.power.power),
        ("commanded_length_change_m", RUN.commanded, RUN.commanded.length_change),
    ):
        known = np.isfinite(values)
        filled = np.isfinite(columns[name])
        np.testing.assert_array_equal(columns[name][filled], values[known])
        np.testing.assert_array_equal(columns["stamp_ns"][filled], samples.stamp[known])
    assert np.all(np.diff(columns["stamp_ns"]) >= 0)
    assert len({len(column) for column in columns.values()}) == 1


def test_each_quantity_has_a_unit_in_its_name():
    joints = JointSamples(("cable_1",), np.array([5]), *3 * (np.array([[0.5]]),))
    numbers = {
        name
        for name, column in run_table(dataclasses.replace(RUN, joint_states=joints)).columns.items()
        if column.dtype.kind == "f"
    }
    assert {name for name in numbers if name.startswith("cable_1")} == {
        *("cable_1_position_rad", "cable_1_velocity_rad_s", "cable_1_effort_Nm")
    }
    assert all(
        name.endswith(("_s", "_m", "_W", "_V", "_A", "_rad", "_rad_s", "_Nm")) for name in numbers
    )


def test_time_and_cycle_count_from_the_onset():
    columns = run_table(RUN).columns
    assert columns["time_s"][0] == pytest.approx(-REST_S)
    cycle, time = columns["cycle"], columns["time_s"]
    assert set(cycle[time < 0.0]) == {0}
    inside = (time >= 0.0) & (time < 1.9 * GAIT.period)
    np.testing.assert_array_equal(cycle[inside], 1 + time[inside] // GAIT.period)


def test_each_gait_of_a_recording_has_a_time_of_its_own():
    run = joined_session()
    columns = run_table(run).columns
    assert sorted(set(columns["gait"])) == [1, 2]
    for number in (1, 2):
        time = columns["time_s"][columns["gait"] == number]
        assert time.min() < 0.0 < time.max()


def test_a_power_that_is_not_valid_is_no_number():
    status = RUN.power.status.copy()
    status[3] = 1
    run = dataclasses.replace(RUN, power=dataclasses.replace(RUN.power, status=status))
    columns = run_table(run).columns
    row = np.flatnonzero(columns["power_status"] == "overflow")
    assert np.isnan(columns["power_W"][row]).all()


def test_a_data_frame_has_the_same_columns(monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pandas", reason="pandas is optional")
    table = run_table(RUN)
    frame = table.to_dataframe()
    assert list(frame) == list(table.columns)
    assert frame.x1_m.count() == np.isfinite(RUN.tracker.rear_position).sum()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        table.to_dataframe()
