# SPDX-License-Identifier: Apache-2.0
import pytest
from driver_rig import settings

from worm_driver.control.driver_settings import load_body
from worm_driver.driver_errors import ConfigurationError
from worm_driver.servos.transmission import Fin, Spool
from worm_msgs.robot_parameters import RobotParameters


def test_without_a_file_the_body_is_the_papers():
    assert load_body("") == RobotParameters()


def test_a_parameter_file_gives_its_keys_and_the_rest_is_the_papers(tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("rear_mass: 0.5\npitch: 0.0173\nintervals: {pitch: [0.017, 0.018]}\n")
    body = load_body(str(file))
    assert (body.rear_mass, body.front_mass, body.pitch) == (0.5, 0.429, 0.0173)
    assert body.mass == pytest.approx(0.929)


@pytest.mark.parametrize(
    "text",
    ["rear_mass: heavy", "rear_mass: -1", "rear_mass: .nan", "- 1", "a: [", "rear_mass: true"],
)
def test_a_bad_parameter_file_is_rejected_by_name(tmp_path, text):
    file = tmp_path / "parameters.yaml"
    file.write_text(text)
    with pytest.raises(ConfigurationError, match=r"parameters\.yaml"):
        load_body(str(file))


def test_a_missing_parameter_file_is_rejected(tmp_path):
    with pytest.raises(ConfigurationError, match="cannot be read"):
        load_body(str(tmp_path / "none.yaml"))


@pytest.mark.parametrize("rate", [10.0, 12.4])
def test_a_rate_at_which_the_servos_stop_between_two_cycles_is_rejected(rate):
    with pytest.raises(
        ConfigurationError, match=r"rate_hz is 1\d.*bus_watchdog_s, 0\.08 s.*12\.5 Hz"
    ):
        settings(rate=rate)
    assert settings(rate=rate, watchdog=0.2).period == 1.0 / rate


@pytest.mark.parametrize("watchdog", [0.05, 0.07, 0.0805, 1.99])
def test_a_watchdog_that_the_servos_would_round_is_rejected(watchdog):
    with pytest.raises(ConfigurationError, match=rf"bus_watchdog_s is {watchdog}.*0\.02 s"):
        settings(watchdog=watchdog)


def test_every_multiple_of_the_servos_step_is_accepted():
    for steps in range(2, 101):
        assert settings(watchdog=steps / 50, rate=100.0).watchdog == steps / 50


def test_a_robot_without_a_cable_servo_is_rejected():
    with pytest.raises(ConfigurationError, match=r"cable_servos\.ids"):
        settings(spools=())


def test_an_id_that_two_servos_have_is_rejected():
    with pytest.raises(ConfigurationError, match=r"\bid 1\b"):
        settings(spools=(Spool(1, 1, 0.012),), fins=(Fin(1, 0.0, 1.0),))


@pytest.mark.parametrize("number", [-1, 253, 254])
def test_an_id_that_no_servo_can_have_is_rejected(number):
    with pytest.raises(ConfigurationError, match="not in 0 to 252"):
        settings(spools=(Spool(number, 1, 0.012),))
