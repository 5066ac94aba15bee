# SPDX-License-Identifier: Apache-2.0
"""The system file: settings, modes and the resulting command lines."""

from pathlib import Path

import pytest
import yaml

from worm_model.errors import InputError
from worm_msgs.conditions import Conditions
from worm_optimizer.operation.system import (
    MODES,
    NodeDescription,
    Robot,
    load_system_file,
    settings_of,
)

SHIPPED = Path(__file__).resolve().parents[4] / "src/worm_optimizer/config/system.yaml"
TWIN = {"package": "p", "executable": "t"}
MINIMAL = {
    "namespace": "worm",
    "settings": {"port": {"default": "/dev/bus", "description": "a bus"}},
    "nodes": {
        "driver": {
            "package": "p",
            "executable": "e",
            "modes": ["robot", "virtual"],
            "parameters": {
                "rate": 100.0,
                "robot": {"port": "{port}"},
                "virtual": {"port": "x/{port}"},
            },
        },
        "twin": TWIN,
    },
}


def written(folder: Path, content: object) -> Path:
    path = folder / "system.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_mode_selects_nodes_and_parameters(tmp_path):
    content = load_system_file(written(tmp_path, MINIMAL))
    assert content.system("robot").node("driver").parameters == {"rate": 100.0, "port": "/dev/bus"}
    assert content.system("virtual").node("driver").parameters["port"] == "x//dev/bus"
    assert [node.name for node in content.system("replay").nodes] == ["twin"]


def test_a_virtual_robots_clock_is_its_own_and_a_replays_is_that_of_ros():
    content = load_system_file(SHIPPED)
    remappings = {mode: content.system(mode).node("twin").remappings for mode in MODES}
    assert remappings == {"robot": {}, "virtual": {"/clock": "clock"}, "replay": {}}


def test_command_arguments_keep_the_types_of_parameters():
    node = NodeDescription(
        name="driver",
        package="p",
        executable="e",
        arguments=("--seed", "1"),
        parameters={"i2c_bus": "1", "rate": 100.0, "ids": [1, 2]},
        remappings={"power": "supply"},
    )
    arguments = node.command_arguments("worm")
    assert arguments[:3] == ["--seed", "1", "--ros-args"]
    assert "__ns:=/worm" in arguments
    assert "__node:=driver" in arguments
    assert "power:=supply" in arguments
    given = dict(argument.split(":=") for argument in arguments if ":=" in argument)
    assert yaml.safe_load(given["i2c_bus"]) == "1"
    assert isinstance(yaml.safe_load(given["rate"]), float)
    assert yaml.safe_load(given["ids"]) == [1, 2]


def test_values_of_the_drivers_file_hold_unless_an_argument_was_given():
    content = load_system_file(SHIPPED)
    assert not {"port", "i2c_bus"} & set(content.system("robot").node("driver").parameters)
    given = content.system("robot", port="/dev/b", i2c_bus="none").node("driver").parameters
    assert (given["port"], given["i2c_bus"]) == ("/dev/b", "none")


def test_each_virtual_robot_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch):
    content, ports = load_system_file(SHIPPED), set()
    for domain, namespace in (("", "worm"), ("7", "worm"), ("7", "fleet/robot7")):
        monkeypatch.setenv("ROS_DOMAIN_ID", domain)
        system = content.system("virtual", namespace)
        ports.add(str(system.node("driver").parameters["port"]))
    assert len(ports) == 3


def test_an_argument_without_a_value_is_left_out(tmp_path):
    twin = {"package": "p", "executable": "t", "arguments": [["--port", "{port}"], ["--seed", 3]]}
    content = load_system_file(written(tmp_path, {**MINIMAL, "nodes": {"twin": twin}}))
    assert content.system("replay").node("twin").arguments == ("--port", "/dev/bus", "--seed", "3")
    assert content.system("replay", port="").node("twin").arguments == ("--seed", "3")


@pytest.mark.parametrize(
    ("nodes", "message"),
    [
        ({"twin": {"package": "p"}}, "twin: executable is missing"),
        ({"twin": {**TWIN, "modes": ["robto"]}}, "'robto': did you mean robot"),
        ({"twin": {**TWIN, "needs": "prot"}}, "'prot': did you mean port"),
        ({"twin": {**TWIN, "arguments": [["{prot}"]]}}, "'prot': did you mean port"),
        ({"twin": {**TWIN, "end_timeout_s": 0}}, "end_timeout_s must be greater than 0"),
    ],
)
def test_a_malformed_file_is_rejected_with_its_path(tmp_path, nodes, message):
    path = written(tmp_path, {**MINIMAL, "nodes": nodes})
    with pytest.raises(InputError, match=message) as error:
        load_system_file(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize(
    ("mode", "name", "status", "holds"),
    [
        ("robot", "driver", -9, True),
        ("robot", "driver", 1, True),
        ("robot", "driver", 0, False),
        ("robot", "driver", 2, False),  # the option was rejected before anything was opened
        ("robot", "twin", -9, False),
        ("virtual", "driver", -9, False),  # its servos end with the virtual robot
    ],
)
def test_only_a_driver_that_fails_on_a_robot_may_leave_torque_on(mode, name, status, holds):
    node = load_system_file(SHIPPED).system(mode).node(name)
    assert ("torque may be on" in node.end_report(status)) == holds


@pytest.mark.parametrize("mode", MODES)
def test_the_shipped_file_fills_every_setting(mode):
    nodes = load_system_file(SHIPPED).system(mode).nodes
    assert nodes
    for node in nodes:
        assert not any("{" in argument for argument in node.command_arguments("worm"))


def test_on_a_robot_gaits_keep_the_limits_of_its_driver():
    system = load_system_file(SHIPPED)
    robot = system.system("robot", driver_file="/etc/driver.yaml", servo_model="XM430-W350")
    reported = robot.node("optimizer").parameters
    assert reported["limits.driver_file"] == "/etc/driver.yaml"
    assert reported["limits.servo_model"] == "XM430-W350"
    assert not system.system("virtual").node("optimizer").parameters  # the paper's values are used


def test_conditions_reach_twin_optimizer_recorder_and_virtual_robot():
    stated = Conditions(slope_deg=-20.0, tether_n=2.0, tether_n_per_m=0.5, distance_m=3.0)
    settings = settings_of(stated)
    robot = Robot(load_system_file(SHIPPED), "virtual", settings)
    assert robot.conditions == stated
    system = robot.system(bag="b")
    for name in ("twin", "optimizer"):
        given = system.node(name).parameters
        assert {key: given[key] for key in settings} == {k: float(v) for k, v in settings.items()}
    for name in ("recorder", "virtual_robot"):
        arguments = system.node(name).arguments
        assert arguments[arguments.index("--slope") + 1] == "-20.0"
        assert arguments[arguments.index("--tether-length") + 1] == "3.0"


def test_a_namespace_of_its_own_reaches_the_recorder_and_the_folder_of_the_robot():
    system = load_system_file(SHIPPED).system("virtual", "fleet/robot7", bag="b")
    assert "__ns:=/fleet/robot7" in system.node("recorder").command_arguments(system.namespace)
