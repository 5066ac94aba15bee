# SPDX-License-Identifier: Apache-2.0
"""Limits from the driver's parameter file and its servo models."""

import dataclasses
import math
from pathlib import Path

import pytest
import yaml

from worm_model.errors import InputError
from worm_model.gait import FORWARD, Gait
from worm_model.parameters import PAPER
from worm_msgs.driver_file import DriverFile, read_driver_file
from worm_optimizer.evaluation.actuator_limits import NO_LIMITS, ActuatorLimits, peaks
from worm_optimizer.evaluation.servo_limits import limits_of, servo_model, within
from worm_optimizer.evaluation.task import Bounds

ROOT = Path(__file__).resolve().parents[4]
DRIVER_FILE = ROOT / "src" / "worm_driver" / "config" / "driver.yaml"


@pytest.fixture
def driver_file(tmp_path):
    def write(**parameters) -> Path:
        path = tmp_path / "driver.yaml"
        path.write_text(yaml.safe_dump({"/worm/driver": {"ros__parameters": parameters}}))
        return path

    return write


def test_the_defaults_are_those_of_the_driver(driver_file):
    assert read_driver_file(DRIVER_FILE) == read_driver_file(driver_file(port=DriverFile.port))
    driver = yaml.safe_load(DRIVER_FILE.read_text())["/**/driver"]["ros__parameters"]
    for row in dataclasses.fields(DriverFile):
        value = driver
        for part in row.metadata["alias"].split("."):
            value = value[part]
        assert value == (list(row.default) if isinstance(row.default, tuple) else row.default), row


def test_a_misspelt_name_is_rejected_and_names_of_ros_are_accepted(driver_file):
    with pytest.raises(InputError, match=r"did you mean limits\.max_stroke_m\?") as reported:
        read_driver_file(driver_file(limits={"max_strok_m": 0.05}))
    assert "max_strok_m'" in str(reported.value)
    ros = {"use_sim_time": False, "qos_overrides": {"/tf.publisher.depth": 5}}
    assert read_driver_file(driver_file(**ros)) == read_driver_file(DRIVER_FILE)


def test_an_xm430_on_the_drivers_spool():
    """Computed manually: 45.8 rpm and 4.1 N·m · 2.0 A/2.3 A on a spool of 25 mm; 3.2 A at 12 V."""
    limits = limits_of(read_driver_file(DRIVER_FILE), servo_model("XM430-W350"), None)
    assert limits.cable_speed == pytest.approx(0.025 * 45.8 * 2 * math.pi / 60)
    assert limits.cable_force == pytest.approx(4.1 * 2.0 / 2.3 / 0.025)
    assert limits.electrical_power == pytest.approx(38.4)
    assert limits.stall_force == pytest.approx(4.1 / 0.025)
    assert limits.no_load_speed == pytest.approx(0.025 * 46.0 * 2 * math.pi / 60)


def test_a_weaker_supply_means_less_speed_and_torque():
    driver, model = read_driver_file(DRIVER_FILE), servo_model("XM430-W350")
    full, weak = limits_of(driver, model, None), limits_of(driver, model, 10.0)
    assert weak.no_load_speed == pytest.approx(full.no_load_speed * 10.0 / 12.0)
    assert weak.cable_speed == weak.no_load_speed  # now below the limit in the servo
    assert weak.stall_force == pytest.approx(full.stall_force * 10.0 / 12.0)
    assert weak.cable_force == pytest.approx(weak.stall_force)  # it stalls below the driver's 2 A
    assert weak.electrical_power == pytest.approx(32.0)


def test_two_cables_pull_together_and_the_slimmer_spool_is_the_slower(driver_file):
    radii = [0.02, 0.025]
    two = read_driver_file(driver_file(cable_servos={"ids": [1, 2], "spool_radius_m": radii}))
    limits = limits_of(two, servo_model("XL430-W250"), None)
    # a ratio: this servo measures no current
    assert limits.cable_force == pytest.approx(2 * 0.9 * 1.5 / 0.025)
    assert limits.stall_force == pytest.approx(2 * 1.5 / 0.025)
    assert limits.no_load_speed == pytest.approx(0.02 * 61.0 * 2 * math.pi / 60)


def test_the_range_of_the_sensor_is_that_of_its_shunt_or_none(driver_file):
    def power(**parameters) -> float:
        return limits_of(read_driver_file(driver_file(**parameters)), None, 10.0).electrical_power

    assert power(**{"ina219.shunt_resistance_ohm": 0.2}) == pytest.approx(16.0)
    assert power(i2c_bus="") == math.inf
    assert power(i2c_bus="none") == math.inf


def test_a_driver_that_takes_less_narrows_the_box_and_a_stricter_limit_stays(driver_file):
    file = driver_file(limits={"max_stroke_m": 0.05, "max_frequency_hz": 1.0})
    bounds, limits = within(Bounds(), ActuatorLimits(cable_speed=0.01), str(file), "", None)
    assert bounds == Bounds(stroke_high=0.05)
    assert limits == ActuatorLimits(cable_speed=0.01)
    assert within(Bounds(), NO_LIMITS, "", "", None) == (Bounds(), NO_LIMITS)


def test_the_motors_line_counts_while_the_cable_is_pulled():
    """F/F_stall + v/v0 at the time of its maximum, and below the sum of both peaks."""
    gait, limits = Gait(0.07, 0.3), ActuatorLimits(stall_force=164.0, no_load_speed=0.12)
    peak = peaks([gait.stroke], [gait.frequency], FORWARD, PAPER, limits)
    speed = math.pi * gait.stroke * gait.frequency
    assert peak.motor_load < peak.force / 164.0 + speed / 0.12
    assert peak.motor_load > max(peak.force / 164.0, speed / 0.12)
    assert peaks([gait.stroke], [gait.frequency], FORWARD, PAPER).motor_load == 0.0
