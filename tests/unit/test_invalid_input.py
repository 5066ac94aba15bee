# SPDX-License-Identifier: Apache-2.0
"""Every executable with ROS ends with status 2 and the reason if it cannot use an argument, a parameter or a file."""

import importlib
import sys
from pathlib import Path

import pytest
from camera_rig import SETUP_FILE
from recorded_run import simulated_run, write_bag

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.message_block import Topic

pytest.importorskip("rclpy", reason="no ROS is installed")

PACKAGES = {
    "demo": "worm_optimizer.commands",
    "operate": "worm_optimizer.commands",
    "optimizer_node": "worm_optimizer.nodes",
    "play": "worm_model.nodes",
    "record": "worm_model.nodes",
    "tracker_node": "worm_driver.nodes",
    "twin_node": "worm_model.nodes",
    "virtual_robot": "worm_driver.nodes",
    "watch": "worm_model.nodes",
}
LIGHT = ["-p", "scan_highest_m:=0.004", "-p", "scan_step_m:=0.001", "-p", "samples:=20"]
GAIT = ["--stroke", "0.03", "--frequency", "0.4"]
BAD = [
    ("demo", ["--parameters", "nowhere.yaml"], "nowhere.yaml"),
    ("operate", ["run", "--stroke", "0.05"], "give --stroke and --frequency"),
    ("operate", ["run", "--stroke", "-1", "--frequency", "0.2"], "stroke"),
    ("operate", ["run", *GAIT, "--objective", "cruise"], "omit --objective"),
    ("operate", ["run", "--pretension", "0.01"], "--pretension needs a gait in numbers"),
    ("operate", ["run", "--profile", "trapezoid", "--objective", "cruise"], "--profile needs"),
    ("operate", ["run", *GAIT, "--contraction-share", "1"], "contraction_share"),
    ("operate", ["run", "--cycles", "-3"], "cycles: -3"),
    ("operate", ["tune", "--stroke", "0.05"], "give --stroke and --frequency"),
    ("operate", ["tune", "--probability", "1"], "--probability 1"),
    ("operate", ["tune", "--grooves", "0"], "--grooves 0"),
    ("operate", ["dance"], "invalid choice"),
    ("optimizer_node", ["-p", "parameter_file:=/nowhere.yaml"], "/nowhere.yaml: cannot be read"),
    (
        "optimizer_node",
        [*LIGHT, "-p", "stroke_low_m:=0.09", "-p", "stroke_high_m:=0.01"],
        "bounds: stroke from 0.09 to 0.01 m",
    ),
    (
        "optimizer_node",
        [*LIGHT, "-p", "limits.servo_model:=XM430-W350"],
        "without the driver's parameter file",
    ),
    ("play", ["no_bag"], "no_bag does not exist"),
    ("play", ["bag", "--rate", "0"], "--rate"),
    ("play", ["bag", "--start", "1000"], "after the end"),
    ("play", ["bag", "--topic", "/no"], "no topic /no"),
    ("play", ["bag", "--exclude", "."], "none of the selected topics"),
    ("play", ["bag", "--exclude", "("], "regular expression"),
    (
        "play",
        ["other_layout"],
        "'/worm/power' is not played: the worm_msgs/msg/Power of the bag differs",
    ),
    ("play", ["bag", "-p", "frobnicate:=1"], "no parameter frobnicate"),
    ("record", [], "no topics"),
    ("record", ["--regex", "("], "not a regular expression"),
    ("record", ["-a", "--note", "x"], "KEY=VALUE"),
    ("record", ["-a", "--parameters", "no.yaml"], "no.yaml"),
    ("record", ["-a", "--output", "."], "exists already"),
    ("record", ["-a", "--snapshot", "-1"], "negative"),
    ("record", ["-a", "--snapshot", "nan"], "finite"),
    ("record", ["a b"], "not a name of a topic"),
    ("record", ["-a", "--note", "pipe=\udcff"], "UTF-8"),
    ("record", ["-a", "-p", "frobnicate:=1"], "no parameter frobnicate"),
    ("tracker_node", ["-p", "setup_file:=/none.yaml"], "tracker: /none.yaml: "),
    (
        "tracker_node",
        ["-p", f"setup_file:={SETUP_FILE}", "-p", "image_transport:=theora"],
        "one of raw, compressed",
    ),
    ("twin_node", ["-p", "parameter_file:=bad.yaml"], "did you mean rear_mass"),
    ("virtual_robot", ["--directory", "r", "--fault", "fire"], "no fault 'fire'"),
    ("virtual_robot", ["--directory", "r", "--parameters", "/nowhere.yaml"], "No such file"),
    ("virtual_robot", ["--directory", "r", "--slope", "91"], "slope_deg"),
    ("virtual_robot", ["--directory", "r", "--tether", "nan"], "tether_n"),
    ("virtual_robot", ["--directory", "/proc/robot"], "choose another --directory"),
    ("virtual_robot", ["--directory", "r", "-p", "frobnicate:=1"], "no parameter frobnicate"),
    ("watch", ["-p", "frobnicate:=1"], "no parameter frobnicate"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("input")
    write_bag(made / "bag", simulated_run(cycles=1))
    other = Topic("/worm/power", "worm_msgs/msg/Power", 0, "float32 power\n", "ros2msg", "cdr")
    with new_bag(made / "other_layout") as writer:
        writer.write(other, b"\0\1\0\0" + bytes(4), 1, 1)
    (made / "bad.yaml").write_text("rear_mas: 1\n")
    return made


@pytest.mark.parametrize(("executable", "arguments", "expected"), BAD)
def test_bad_input_is_one_line_and_status_two(
    executable, arguments, expected, folder, ros_domain, monkeypatch, capfd, caplog
):
    name = executable if executable.endswith("_node") else f"{executable}_node"
    package = PACKAGES[executable]
    module = importlib.import_module(
        f"{package}.{name if package.endswith('nodes') else executable}"
    )
    if "-p" in arguments:
        start = arguments.index("-p")
        arguments = [*arguments[:start], "--ros-args", *arguments[start:]]
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [executable, *arguments])
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    try:
        status = module.main()
    except SystemExit as end:
        status = end.code
    reported = capfd.readouterr().err + caplog.text
    assert status == 2
    assert expected in reported
    assert "Traceback" not in reported
