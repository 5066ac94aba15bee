# SPDX-License-Identifier: Apache-2.0
"""A node's response to invalid arguments and parameters."""

import math
import sys
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_msgs.executable import node
from worm_msgs.node_command import declare
from worm_msgs.parameter_rows import ParameterRow


def rows():
    return [
        ParameterRow("speed_m_per_s", 0.5, "Of it.", 0.0, 1.0),
        ParameterRow("radii_m", [0.1], "Of them."),
        ParameterRow("count", 3, "How many."),
        ParameterRow("rate_hz", 10.0, "How often.", read_only=True),
        ParameterRow("margin_m", math.nan, "NaN: chosen."),
    ]


NAMES = [row.name for row in rows()]


@pytest.fixture(autouse=True)
def _domain(ros_domain) -> Iterator[None]:
    yield
    rclpy.try_shutdown()


def main_of(run: Callable[[object], None]) -> Callable[[list[str]], int]:
    """Return the ``main`` of a node that consists of its function ``run``."""
    sys.modules["machine_node"] = SimpleNamespace(
        rows=rows, run=run, REJECTIONS=(ZeroDivisionError,)
    )
    return node("machine", "A machine.", "machine_node", "machine_node")


def started(*arguments: str) -> tuple[int, dict[str, object], list[object]]:
    """Return the exit status, the node's values, and the result of setting the speed to a whole number."""
    values, answers = {}, []

    def run(_) -> None:
        node = Node("machine")
        try:
            declare(node, rows)
            values.update({name: node.get_parameter(name).value for name in NAMES})
            answers.extend(node.set_parameters([Parameter("speed_m_per_s", value=1)]))
            answers.append(node.get_parameter("speed_m_per_s").value)
        finally:
            node.destroy_node()

    return main_of(run)(["machine", *arguments]), values, answers


def rejected(capsys, *arguments: str) -> str:
    """Return the only line on standard error after a rejected command line."""
    try:
        status = started(*arguments)[0]
    except SystemExit as error:
        status = error.code
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_whole_numbers_are_values_of_floats_at_the_start_and_later():
    given = ("--ros-args", "-p", "speed_m_per_s:=1", "-p", "radii_m:=[1, 2]", "-p", "count:=4")
    given += ("-p", "margin_m:=.nan")  # as in the node's own dump
    status, values, (answer, value) = started(*given)
    assert status == 0
    assert (values["speed_m_per_s"], values["count"]) == (1.0, 4)
    assert isinstance(values["speed_m_per_s"], float)
    assert math.isnan(values["margin_m"])
    assert list(values["radii_m"]) == [1.0, 2.0]
    assert answer.successful
    assert value == 1.0


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (
            ["-p", "sped_m_per_s:=1.0"],
            "machine: no parameter sped_m_per_s: did you mean speed_m_per_s?",
        ),
        (
            ["-p", "zzz:=1"],
            "machine: no parameter zzz: the parameters are count, margin_m, radii_m, rate_hz, speed_m_per_s",
        ),
        (["-p", "speed_m_per_s:=-1"], "out of range"),
        (["-p", "speed_m_per_s:=fast"], "expecting type 'DOUBLE'"),
        (["-p", "count:=1.5"], "expecting type 'INTEGER'"),
        (["--params-file", "/nope"], "/nope"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_2(capsys, given, expected):
    assert expected in rejected(capsys, "--ros-args", *given)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("/machine", ""),
        ("machine", ""),
        ("/**", ""),
        ("/*", ""),
        ("/**/machine", ""),
        ("/robot7/machine", "is for /robot7/machine; the name of this node is /machine"),
        ("/machin", "is for /machin; the name of this node is /machine"),
        ("/*/machine", "is for /*/machine; the name of this node is /machine"),
    ],
)
def test_a_file_for_another_name_of_the_node_is_rejected(
    capsys, monkeypatch, tmp_path, name, expected
):
    """rcl itself ignores it, and the node would run with the values of another robot."""
    file = tmp_path / "robot.yaml"
    content = "{ros__parameters: {speed_m_per_s: 0.25}}"
    file.write_text(f"'{name}': {content}\nelsewhere: {{deep: {content}}}\n")
    arguments = ["--ros-args", "--params-file", str(file)]
    monkeypatch.setattr("sys.argv", ["machine", *arguments])
    status, values, _ = started(*arguments)
    assert status == (2 if expected else 0)
    assert values.get("speed_m_per_s") == (None if expected else 0.25)
    assert expected in capsys.readouterr().err


def test_a_file_for_other_nodes_alone_is_reported(capfd, monkeypatch, tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text("a: {b: {ros__parameters: {x: 1}}}\n")
    monkeypatch.setattr("sys.argv", ["machine", "--ros-args", "--params-file", str(file)])
    assert started()[0] == 0
    assert "no parameters of /machine, only of /a/b" in capfd.readouterr().err


def test_a_file_that_only_the_parser_of_ros_reads_is_used(monkeypatch, tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text("/a: {}\n---\n/**:\n  ros__parameters:\n    speed_m_per_s:\t!si 25e-2\n")
    arguments = ["--ros-args", "--params-file", str(file)]
    monkeypatch.setattr("sys.argv", ["machine", *arguments])
    assert started(*arguments)[1]["speed_m_per_s"] == 0.25


def test_help_names_every_parameter_and_starts_nothing(capsys):
    with pytest.raises(SystemExit) as error:
        started("--help")
    assert error.value.code == 0
    text = capsys.readouterr().out
    assert all(f"{name}  (default" in text for name in NAMES)


def test_a_node_takes_its_own_values_and_no_other_for_what_is_read_only():
    rclpy.init(args=["machine"])
    node = Node("machine")
    declare(node, rows)
    own = [node.get_parameter(name) for name in node.get_parameters_by_prefix("")]
    assert {p.name for p in own} >= {"start_type_description_service", "use_sim_time", *NAMES}
    assert all(answer.successful for answer in node.set_parameters(own))
    assert node.set_parameters_atomically(own).successful
    other = Parameter("rate_hz", value=11.0)
    assert not node.set_parameters_atomically([*own, other]).successful
    assert node.get_parameter("rate_hz").value == 10.0
