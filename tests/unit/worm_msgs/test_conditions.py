# SPDX-License-Identifier: Apache-2.0
"""Conditions in the pipe, as the commands of the model and the file and options of the virtual robot read them."""

import dataclasses

import pytest
import yaml

from worm_driver.nodes import virtual_robot_command, virtual_robot_node
from worm_driver.virtual_robot.plant import Plant, PlantEffects, make_grooves
from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE, load_settings
from worm_model.commands.command_line import Parser
from worm_model.loads import under
from worm_model.parameters import PAPER
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions, conditions_of


def options_of(values):
    """Return the conditions as options; "=" lets values begin with a minus."""
    return [f"{CONDITION_ROWS[name]['option']}={value}" for name, value in values.items()]


def by_the_model(values, tmp_path):
    parser = Parser(prog="simulate")
    parser.add_conditions()
    return conditions_of(parser.parse_args(options_of(values)))


def by_the_options_of_the_virtual_robot(values, tmp_path):
    options = ["--directory", str(tmp_path), *options_of(values)]
    given = virtual_robot_command._parser().parse_args(options)
    return virtual_robot_node.make_robot(given).plant.conditions


def by_the_file_of_the_virtual_robot(values, tmp_path):
    path = tmp_path / "robot.yaml"
    content = yaml.safe_load(DEFAULT_FILE.read_text())
    path.write_text(yaml.safe_dump({**content, "conditions": values}))
    return load_settings(path).conditions


USERS = (by_the_model, by_the_options_of_the_virtual_robot, by_the_file_of_the_virtual_robot)


@pytest.mark.parametrize("user", USERS)
@pytest.mark.parametrize(
    "values",
    [
        {},
        {"slope_deg": -90.0},
        {"tether_n": 2.0},
        {"tether_n_per_m": 0.5},  # from the start on, which is at the mouth of the pipe
        {"tether_n_per_m": 0.5, "distance_m": 3.0},
        {"drag_area_m2": 0.004},  # still water
        {"drag_area_m2": 0.004, "flow_m_per_s": -0.5},
    ],
)
def test_all_users_accept_the_same_conditions(user, values, tmp_path):
    assert user(values, tmp_path) == Conditions(**values)


@pytest.mark.parametrize("user", USERS)
@pytest.mark.parametrize(
    ("values", "facts"),
    [
        ({"slope_deg": 91.0}, ["slope_deg", "91", "90"]),
        ({"slope_deg": float("inf")}, ["slope", "inf"]),
        ({"tether_n": -3.0}, ["tether_n", "-3", "0"]),  # a tether cannot push
        ({"tether_n": 1e9}, ["tether_n", "1000"]),
        ({"tether_n_per_m": -1.0}, ["tether_n_per_m", "-1"]),
        ({"distance_m": 2.0}, ["distance_m", "2", "tether_n_per_m"]),
        ({"flow_m_per_s": 1.0}, ["flow_m_per_s", "1", "drag_area_m2"]),
    ],
)
def test_all_users_reject_the_same_conditions(user, values, facts, tmp_path, capsys):
    with pytest.raises((ValueError, SystemExit)) as caught:
        user(values, tmp_path)
    message = str(caught.value) if isinstance(caught.value, ValueError) else capsys.readouterr().err
    assert [fact for fact in facts if fact not in message] == []
    assert "\n" not in message.strip()


def test_the_tether_grows_with_the_distance_and_stays_behind_the_start():
    conditions = Conditions(tether_n=1.0, tether_n_per_m=2.0, distance_m=3.0)
    assert [conditions.tether(x) for x in (0.0, 0.5, -0.5)] == [7.0, 8.0, 7.0]


@pytest.mark.parametrize(
    "conditions",
    [
        Conditions(slope_deg=20.0, tether_n=2.0, tether_n_per_m=0.5, distance_m=3.0),
        Conditions(flow_m_per_s=-0.5, drag_area_m2=0.004),
        Conditions(drag_area_m2=0.004),
        Conditions(tether_n_per_m=0.5),
        LEVEL,
    ],
)
def test_model_and_virtual_robot_have_the_same_loads_at_rest(conditions):
    effects = PlantEffects(0.0, 0.0, 0.0, 1.0)
    grooves = [make_grooves(PAPER, effects, seed) for seed in (1, 2)]
    plant, model = Plant(PAPER, effects, *grooves, 1e-3, conditions), under(conditions, PAPER)
    assert plant._loads(0.0, 0.0, 0.0) == pytest.approx((model.rear_load, model.front_load))
    # The derivative of load and drag at rest is the viscous friction of the model.
    speed = 1e-6
    moved = dataclasses.replace(plant, parameters=PAPER)._loads(0.0, speed, speed)[1]
    drag = (plant._drags(speed, speed)[1]) * speed
    friction = (moved + drag - model.front_load) / speed
    assert friction == pytest.approx(model.viscous_friction, rel=1e-5)
