# SPDX-License-Identifier: Apache-2.0
"""The launch file's own logic, with ROS' launch system made up: it is not among the wheels."""

import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from worm_optimizer.operation.system import NodeDescription, load_system_file

PACKAGE = Path(__file__).resolve().parents[4] / "src" / "worm_optimizer"
MADE_UP = {
    "launch": ["LaunchContext", "LaunchDescription", "LaunchDescriptionEntity"],
    "launch.actions": [
        *("DeclareLaunchArgument", "OpaqueFunction", "RegisterEventHandler", "Shutdown"),
    ],
    "launch.event_handlers": ["OnProcessIO"],
    "launch.events.process": ["ProcessIO"],
    "launch.substitutions": ["LaunchConfiguration"],
    "launch_ros": [],
    "launch_ros.actions": ["LifecycleNode", "LifecycleTransition", "Node"],
    "launch_ros.parameter_descriptions": ["ParameterValue"],
    "lifecycle_msgs.msg": [],
}


class Entity:
    """Stands for any action, event or handler: remembers what it was made with."""

    def __init__(self, *args, **options) -> None:
        self.args, self.options = args, options

    def __getattr__(self, name: str):
        try:
            return self.options[name]
        except KeyError:
            raise AttributeError(name) from None


@pytest.fixture
def launch_file(monkeypatch) -> ModuleType:
    for module, names in MADE_UP.items():
        made = ModuleType(module)
        for name in names:
            setattr(made, name, type(name, (Entity,), {}))
        monkeypatch.setitem(sys.modules, module, made)
    transition = SimpleNamespace(TRANSITION_CONFIGURE=1, TRANSITION_ACTIVATE=3)
    sys.modules["lifecycle_msgs.msg"].Transition = transition
    index = ModuleType("ament_index_python.packages")
    index.get_package_share_directory = lambda _: str(PACKAGE)
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", index)
    spec = importlib.util.spec_from_file_location("launched", PACKAGE / "launch" / "worm.launch.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def kinds(entities) -> list[str]:
    return [type(entity).__name__ for entity in entities]


def flat(launch_file, nodes):
    return launch_file._start_in_order(tuple(nodes), "worm")


def described(name: str, **more) -> NodeDescription:
    return NodeDescription(name=name, package="package", executable=name, **more)


def started(entities) -> list[str]:
    return [entity.name for entity in entities if type(entity).__name__.endswith("Node")]


def handlers(entities, kind: str) -> Iterator[Entity]:
    for entity in entities:
        if type(entity).__name__ == "RegisterEventHandler":
            (handler,) = entity.args
            if type(handler).__name__ == kind:
                yield handler


def says(handler: Entity, text: bytes) -> list:
    return handler.on_stdout(SimpleNamespace(text=text))


def test_the_nodes_after_one_that_others_wait_for_start_once_it_is_ready(launch_file):
    nodes = [described("a"), described("b", ready="ready:"), described("c", ready="go")]
    nodes.append(described("d"))
    first = flat(launch_file, nodes)
    assert started(first) == ["a", "b"]
    (waiting,) = handlers(first, "OnProcessIO")
    assert waiting.target_action is first[-1]  # b
    assert says(waiting, b"not yet\n") == []
    second = says(waiting, b"well\nready: /tmp\n")
    assert started(second) == ["c"]
    assert says(waiting, b"ready: again\n") == []  # once is enough
    (waiting,) = handlers(second, "OnProcessIO")
    assert started(waiting.on_stderr(SimpleNamespace(text=b"[INFO] go\n"))) == ["d"]


def test_a_node_that_ends_ends_all_but_not_twice(launch_file):
    (node,) = flat(launch_file, [described("a")])
    function, (name,) = node.on_exit.options["function"], node.on_exit.options["args"]
    assert kinds(function(SimpleNamespace(is_shutdown=False), name)) == ["Shutdown"]
    assert function(SimpleNamespace(is_shutdown=True), name) == []


def test_texts_stay_texts(launch_file):
    (node,) = flat(launch_file, [described("a", parameters={"i2c_bus": "1", "rate": 100.0})])
    (parameters,) = node.parameters
    assert parameters["i2c_bus"].args == ("1",)
    assert parameters["i2c_bus"].value_type is str
    assert parameters["rate"] == 100.0


def test_a_lifecycle_node_is_configured_and_activated(launch_file):
    entities = flat(launch_file, [described("driver", lifecycle=True)])
    assert kinds(entities) == ["LifecycleNode", "LifecycleTransition"]
    assert entities[1].lifecycle_node_names == ["/worm/driver"]
    assert entities[1].transition_ids == [1, 3]


@pytest.mark.parametrize("mode", ["robot", "virtual"])
def test_a_mode_starts_its_nodes(launch_file, monkeypatch, mode):
    content = load_system_file(PACKAGE / "config" / "system.yaml")
    values = {name: row.default for name, row in content.settings.items()} | {"mode": mode}

    class Configuration:
        def __init__(self, name: str) -> None:
            self._name = name

        def perform(self, _) -> str:
            return values[self._name]

    monkeypatch.setattr(launch_file, "LaunchConfiguration", Configuration)
    entities = launch_file._start(None, content)
    names = started(entities)
    for waiting in handlers(entities, "OnProcessIO"):
        entities = says(waiting, b"ready: all")
        names += started(entities)
    assert names == [node.name for node in content.system(mode).nodes]


def test_every_setting_is_an_argument(launch_file):
    (arguments,) = launch_file.generate_launch_description().args
    names = [each.args[0] for each in arguments if type(each).__name__ == "DeclareLaunchArgument"]
    settings = load_system_file(PACKAGE / "config" / "system.yaml").settings
    assert names == ["mode", *settings]
