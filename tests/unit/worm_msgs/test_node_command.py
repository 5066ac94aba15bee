# SPDX-License-Identifier: Apache-2.0
"""What a node does with a command line and with parameters that it cannot use."""

from collections.abc import Iterator

import pytest

pytest.importorskip("worm_msgs", reason="worm_msgs is not built")
rclpy = pytest.importorskip("rclpy", reason="no ROS is installed")

from rcl_interfaces.msg import FloatingPointRange, ParameterDescriptor  # noqa: E402
from rclpy.node import Node  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402

from worm_msgs.node_command import declare, declare_none, run_node  # noqa: E402


def rows():
    span = FloatingPointRange(from_value=0.0, to_value=1.0)
    return [
        ("speed_m_s", 0.5, ParameterDescriptor(description="Of it.", floating_point_range=[span])),
        ("radii_m", [0.1], ParameterDescriptor(description="Of them.")),
        ("count", 3, ParameterDescriptor(description="How many.")),
    ]


@pytest.fixture(autouse=True)
def _domain(ros_domain) -> Iterator[None]:
    yield
    rclpy.try_shutdown()


def started(*words: str) -> tuple[int, dict[str, object], list[object]]:
    """Exit status, the values that the node had, and what setting the speed to a whole number answered."""
    values, answers = {}, []

    def run(_) -> None:
        node = Node("machine")
        try:
            declare(node, rows)
            values.update({name: node.get_parameter(name).value for name, _, _ in rows()})
            answers.extend(node.set_parameters([Parameter("speed_m_s", value=1)]))
            answers.append(node.get_parameter("speed_m_s").value)
        finally:
            node.destroy_node()

    status = run_node("machine", "A machine.", rows, run, (ZeroDivisionError,), ["machine", *words])
    return status, values, answers


def refused(capsys, *words: str) -> str:
    """The one line of a command line that is refused."""
    try:
        status = started(*words)[0]
    except SystemExit as error:
        status = error.code
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


def test_whole_numbers_are_values_of_floats_at_the_start_and_later():
    given = ("--ros-args", "-p", "speed_m_s:=1", "-p", "radii_m:=[1, 2]", "-p", "count:=4")
    status, values, (answer, value) = started(*given)
    assert status == 0
    assert values == {"speed_m_s": 1.0, "radii_m": values["radii_m"], "count": 4}
    assert isinstance(values["speed_m_s"], float)
    assert list(values["radii_m"]) == [1.0, 2.0]
    assert answer.successful
    assert value == 1.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (["-p", "sped_m_s:=1.0"], "machine: no parameter sped_m_s: did you mean speed_m_s?"),
        (["-p", "zzz:=1"], "machine: no parameter zzz: there are count, radii_m, speed_m_s"),
        (["-p", "speed_m_s:=-1"], "out of range"),
        (["-p", "speed_m_s:=fast"], "expecting type 'DOUBLE'"),
        (["-p", "count:=1.5"], "expecting type 'INTEGER'"),
        (["--params-file", "/nope"], "/nope"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_status_2(capsys, given, words):
    assert words in refused(capsys, "--ros-args", *given)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("/machine", ""),
        ("machine", ""),
        ("/**", ""),
        ("/*", ""),
        ("/**/machine", ""),
        ("/robot7/machine", "is for /robot7/machine, and this is /machine"),
        ("/machin", "is for /machin, and this is /machine"),
        ("/*/machine", "is for /*/machine, and this is /machine"),
    ],
)
def test_a_file_for_another_name_of_the_node_is_refused(capsys, monkeypatch, tmp_path, name, said):
    """rcl itself passes over it, and the node runs with the values of another robot."""
    file = tmp_path / "robot.yaml"
    content = "{ros__parameters: {speed_m_s: 0.25}}"
    file.write_text(f"'{name}': {content}\nelsewhere: {{deep: {content}}}\n")
    words = ["--ros-args", "--params-file", str(file)]
    monkeypatch.setattr("sys.argv", ["machine", *words])
    status, values, _ = started(*words)
    assert status == (2 if said else 0)
    assert values.get("speed_m_s") == (None if said else 0.25)
    assert said in capsys.readouterr().err


def test_a_file_for_other_nodes_alone_is_told(capfd, monkeypatch, tmp_path):
    file = tmp_path / "robot.yaml"
    file.write_text("a: {b: {ros__parameters: {x: 1}}}\n")
    monkeypatch.setattr("sys.argv", ["machine", "--ros-args", "--params-file", str(file)])
    assert started()[0] == 0
    assert "holds nothing for /machine, only for /a/b" in capfd.readouterr().err


def test_a_node_without_parameters_refuses_them_all(capsys):
    def run(_) -> None:
        declare_none(Node("machine"))

    words = ["machine", "--ros-args", "-p", "speed_m_s:=1.0"]
    with pytest.raises(SystemExit) as error:
        run_node("machine", "", list, run, (), words)
    assert error.value.code == 2
    assert "machine: no parameter speed_m_s: " in capsys.readouterr().err


def test_a_stray_argument_is_refused(capsys):
    assert "stray" in refused(capsys, "stray")


def test_help_names_every_parameter_and_starts_nothing(capsys):
    with pytest.raises(SystemExit) as error:
        started("--help")
    assert error.value.code == 0
    text = capsys.readouterr().out
    assert all(f"{name}  (default" in text for name, _, _ in rows())


def test_what_the_node_itself_refuses_is_one_line_too(capsys):
    def run(_) -> None:
        raise ZeroDivisionError("no\nway")

    assert run_node("machine", "", rows, run, (ZeroDivisionError,), ["machine"]) == 2
    assert capsys.readouterr().err == "machine: no way\n"
