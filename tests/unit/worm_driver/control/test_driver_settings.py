# SPDX-License-Identifier: Apache-2.0
import pytest
from driver_rig import settings

from worm_driver.control.driver_settings import load_body
from worm_driver.driver_errors import ConfigurationError
from worm_msgs.robot_parameters import RobotParameters


def test_without_a_file_the_body_is_the_papers():
    assert load_body("") == RobotParameters()


def test_a_parameter_file_gives_its_keys_and_the_rest_is_the_papers(tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("rear_mass: 0.5\npitch: 0.0173\nintervals: {pitch: [0.017, 0.018]}\n")
    body = load_body(str(file))
    assert (body.rear_mass, body.front_mass, body.pitch) == (0.5, 0.429, 0.0173)
    assert body.mass == pytest.approx(0.929)


def test_a_bad_parameter_file_is_rejected_by_name(tmp_path):
    file = tmp_path / "parameters.yaml"
    file.write_text("rear_mass: heavy")
    with pytest.raises(ConfigurationError, match=r"parameters\.yaml"):
        load_body(str(file))


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"rate": 10.0}, r"rate_hz is 10.*bus_watchdog_s, 0\.08 s.*12\.5 Hz"),
        ({"rate": 12.4}, r"rate_hz is 12\.4.*12\.5 Hz"),
        *(
            ({"watchdog": step}, rf"bus_watchdog_s is {step}.*0\.02 s")
            for step in (0.05, 0.0805, 1.99)
        ),
        ({"cable_ids": ()}, r"cable_servos\.ids"),
        ({"cable_ids": (11,)}, r"two servos have the id 11\b"),
        *(({"cable_ids": (number,)}, "not in 0 to 252") for number in (-1, 253, 254)),
        ({"cable_ids": (1, 2)}, r"cable_servos\.ids has 2, cable_servos\.signs has 1"),
        ({"reverse_angles": ()}, r"fin_servos\.reverse_angle_rad has 0"),
    ],
)
def test_parameters_that_contradict_each_other_are_rejected(wrong, reason):
    with pytest.raises(ConfigurationError, match=reason):
        settings(**wrong)


def test_every_multiple_of_the_servos_step_is_accepted():
    for steps in range(2, 101):
        assert settings(watchdog=steps / 50, rate=100.0).watchdog == steps / 50
    assert settings(rate=10.0, watchdog=0.2).period == 0.1
