# SPDX-License-Identifier: Apache-2.0
"""Every command and node ends with status 2, the facts and no output if it cannot use its input."""

import importlib
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from camera_rig import SETUP_FILE
from recorded_run import simulated_run, write_bag
from study_cases import SMALL

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.message_block import Topic

BAGS = Path(__file__).resolve().parents[2] / "bags"
FORWARD, REVERSE, FAULTS = (str(BAGS / name) for name in ("forward", "reverse", "faults"))
GAIT = "--stroke 0.07 --frequency 0.2"
EVALUATE, SIMULATE, IDENTIFY, EXPORT, REPLAY = (
    f"worm_model.commands.{name}"
    for name in ("evaluate_gait", "simulate", "identify", "export", "replay")
)
OPTIMIZE, SCAN, CAMPAIGN, REPORT, STUDY, TUNE = (
    f"worm_optimizer.commands.{name}"
    for name in ("optimize", "scan_margin", "campaign", "report", "study", "tune")
)
CALIBRATE, CHECK, SETUP_SERVO = (
    f"worm_driver.commands.{name}" for name in ("calibrate", "check", "setup_servo")
)
TRACK = "worm_driver.commands.track"
IMAGES = f"--images . --setup {SETUP_FILE}"
BAD = [
    (EVALUATE, "--stroke 0.07 --frequency -0.2", "frequency: -0.2 Hz"),
    (EVALUATE, "--stroke nan --frequency 0.2", "--stroke"),
    (EVALUATE, "--stroke 0.07", "--frequency"),
    (EVALUATE, f"{GAIT} --direction 2", "--direction"),
    (EVALUATE, f"{GAIT} --parameters none.yaml", "none.yaml: cannot be read"),
    (EVALUATE, "--gaits gaits.csv", "--output"),
    (EVALUATE, "--gaits none.csv --output out.csv", "none.csv: cannot be read"),
    (EVALUATE, "--gaits gaits.csv --output nowhere/out.csv", "nowhere does not exist"),
    (EVALUATE, "--gaits gaits.csv --output gaits.csv", "gaits.csv: exists"),
    (EVALUATE, "--gaits gaits.csv --output out.csv --slope 10", "rear_load"),
    (EVALUATE, f"{GAIT} --tether 200", "200 N"),
    (EVALUATE, f"{GAIT} --flow 1", "drag_area_m2"),
    (EVALUATE, f"{GAIT} --profile sawtooth", "sawtooth"),
    (EVALUATE, f"{GAIT} --pretension 0.25", "stroke: 0.32 m"),
    (SIMULATE, f"{GAIT} --output x.txt", "end its name in .csv, .mcap"),
    (SIMULATE, f"{GAIT} --output x.csv --cycles 0", "--cycles 0"),
    (SIMULATE, f"{GAIT} --output x.csv --rate 1e9", "--rate"),
    (SIMULATE, f"{GAIT} --output gaits.csv", "exists already"),
    (IDENTIFY, "nowhere", "nowhere does not exist"),
    (IDENTIFY, ".", "is not a bag"),
    (IDENTIFY, "bag --output no/such/folder.yaml", "does not exist"),
    (IDENTIFY, "bag --parameters none.yaml", "none.yaml"),
    (EXPORT, "bag --output bag", "bag: exists"),
    (EXPORT, "no --output x", "no does not exist"),
    (EXPORT, "bag --output x --topic /no", "no topic /no"),
    (REPLAY, "nowhere", "nowhere"),
    (REPLAY, "bag --output bag", "bag"),
    (REPLAY, "bag --namespace /x", "/x"),
    (OPTIMIZE, "--margin -1", "margin: -1.0 m is not between 0 and 0.1 m"),
    (OPTIMIZE, "--margin nan", "not a finite number"),
    (OPTIMIZE, "--margin-n -1", "margin_force: -1.0 N"),
    (OPTIMIZE, "--margin-n 5 --margin 0.001", "margin"),
    (OPTIMIZE, "--strokes 0.09 0.01", "bounds: stroke from 0.09 to 0.01 m"),
    (OPTIMIZE, "--strokes 0 0.09", "bounds: stroke"),
    (OPTIMIZE, "--frequencies -0.1 0.4", "bounds: frequency"),
    (OPTIMIZE, "--strokes 0.01 0.5", "the body is 0.2952 m long"),
    (OPTIMIZE, "--method nsga2 --population 1", "give a population of at least 4"),
    (OPTIMIZE, "--method nsga2 --generations 0", "search:"),
    (OPTIMIZE, "--method nsga2 --seed -1", "seed -1"),
    (OPTIMIZE, "--method nsga2 --waveform shaped", "--waveform sinusoid"),
    (OPTIMIZE, "--waveform shaped --pretensions 0.02 0.01", "bounds: pretension"),
    (OPTIMIZE, "--waveform shaped --contraction-shares 0 0.5", "bounds: contraction_share"),
    (OPTIMIZE, "--waveform shaped --ramp-shares 0.1 0.6", "bounds: ramp_share"),
    (OPTIMIZE, "--population 20", "need --method nsga2"),
    (OPTIMIZE, "--max-power 0.8", "idle power of 0.82 W"),
    (OPTIMIZE, "--max-power 1 --frequencies 0.2 0.2", "electrical_power excludes every gait"),
    (OPTIMIZE, "--max-power -3", "limits: electrical_power = -3.0"),
    (OPTIMIZE, "--servo-model XM430-W350", "without the driver's parameter file"),
    (OPTIMIZE, "--limits-from none.yaml", "none.yaml: cannot be read"),
    (OPTIMIZE, "--figure nowhere/front.png", "its folder nowhere does not exist"),
    (OPTIMIZE, "--figure front.txt", "end its name in .png, .pdf, .svg"),
    (OPTIMIZE, "--robustness luck", "invalid choice: 'luck'"),
    (OPTIMIZE, "--robustness chance --margin 0.002", "--margin 0.002 has no effect"),
    (OPTIMIZE, "--robustness chance --margin-n 2", "--margin-n 2 has no effect"),
    (OPTIMIZE, "--robustness chance --probability 2", "at most 1, not 2.0"),
    (SCAN, "--lowest 0.001 --highest 0", "scan:"),
    (SCAN, "--highest 1", "scan:"),
    (SCAN, "--step 0", "scan:"),
    (SCAN, "--step 1e-9", "scan:"),
    ("worm_optimizer.commands.start", "--set prot=/dev/ttyUSB0", "'prot'"),
    (CAMPAIGN, "--output x --set port", "write NAME=VALUE"),
    (CAMPAIGN, "--output x --set prot=/dev/ttyUSB0", "no setting 'prot'"),
    (CAMPAIGN, "--output x --margin -1", "margin: -1"),
    (CAMPAIGN, "--output x --slope 91", "slope_deg: 91"),
    (CAMPAIGN, "--output x --tether-length 1", "tether_n_per_m"),
    (CAMPAIGN, "--output x --set slope_deg=steep", "steep"),
    (CAMPAIGN, "--output x --parameters none.yaml", "none.yaml: cannot be read"),
    (CAMPAIGN, "--output x --mode imaginary", "invalid choice"),
    (CAMPAIGN, "--output x --identify --bellows none.csv", "--bellows none.csv"),
    (CAMPAIGN, "--output x --fin none.csv", "without --identify"),
    (CAMPAIGN, "--output bag", "exists already"),
    (CAMPAIGN, "--resume bag", "contains no campaign"),
    (CAMPAIGN, "--resume begun --output x", "remove --output"),
    (CAMPAIGN, "--resume complete", "is complete"),
    (REPORT, "", "no recording of a gait in"),
    (REPORT, "nowhere", "nowhere does not exist"),
    (REPORT, "nowhere --output .", "exists already"),
    (REPORT, "nowhere --identification none.yaml", "none.yaml: cannot be read"),
    (STUDY, "none.yaml --output s.nc", "none.yaml: cannot be read"),
    (STUDY, "s.yaml", "--output"),
    (STUDY, "s.yaml --output no/s.nc", "no does not exist"),
    (STUDY, "s.yaml --output s.nc --workers 0", "give at least 1"),
    (STUDY, "s.yaml --parameters none.yaml --output s.nc", "cannot be read"),
    (TUNE, f"{FORWARD} --probability 1", "--probability"),
    (TUNE, f"{FORWARD} --grooves 0", "--grooves"),
    (TUNE, f"{FORWARD} {FORWARD}", "twice"),
    (TUNE, f"{FORWARD} {REVERSE}", "both directions"),
    (TUNE, FAULTS, "not measured"),
    (TUNE, "nowhere", "nowhere"),
    ("worm_driver.commands.bench_tests", "tests --parameters none.yaml", "none.yaml: "),
    (CALIBRATE, "gaits.csv", "already exists"),
    (CALIBRATE, "no/folder.yaml", "its folder does not exist"),
    (CALIBRATE, "new.yaml --turns nan", "--turns"),
    (CHECK, "misspelt.yaml", "port"),
    (CHECK, "twins.yaml", "two servos"),
    (CHECK, "--camera /dev/video0", "--setup"),
    (SETUP_SERVO, "253", "253"),
    (SETUP_SERVO, "x", "'x'"),
    (SETUP_SERVO, "", "required"),
    (SETUP_SERVO, "1 --baud-rate 5", "--baud-rate"),
    (TRACK, IMAGES, "required: --output"),
    (TRACK, f"{IMAGES} --output gaits.csv", "already exists"),
    (TRACK, f"{IMAGES} --output none/out.csv", "create it first"),
    (TRACK, f"{IMAGES} --output out.csv --setup none.yaml", "none.yaml: "),
]

# with ROS
DEMO = "worm_optimizer.commands.demo"
OPERATE = "worm_optimizer.commands.operate"
OPTIMIZER_NODE = "worm_optimizer optimizer_node"
PLAY = "worm_model play"
RECORD = "worm_model record"
TRACKER_NODE = "worm_driver tracker_node"
TWIN_NODE = "worm_model twin_node"
VIRTUAL_ROBOT = "worm_driver virtual_robot"
SHORT = "--stroke 0.03 --frequency 0.4"
LIGHT = "-p scan_highest_m:=0.004 -p scan_step_m:=0.001 -p samples:=20"
BAD_WITH_ROS = [
    (DEMO, "--parameters nowhere.yaml", "nowhere.yaml"),
    (OPERATE, "run --stroke 0.05", "give --stroke and --frequency"),
    (OPERATE, "run --stroke -1 --frequency 0.2", "stroke"),
    (OPERATE, f"run {SHORT} --objective cruise", "omit --objective"),
    (OPERATE, "run --pretension 0.01", "--pretension needs a gait in numbers"),
    (OPERATE, "run --profile trapezoid --objective cruise", "--profile needs"),
    (OPERATE, f"run {SHORT} --contraction-share 1", "contraction_share"),
    (OPERATE, "run --cycles -3", "cycles: -3"),
    (OPERATE, "tune --stroke 0.05", "give --stroke and --frequency"),
    (OPERATE, "tune --probability 1", "--probability 1"),
    (OPERATE, "tune --grooves 0", "--grooves: 0"),
    (OPERATE, "dance", "invalid choice"),
    (OPTIMIZER_NODE, "-p parameter_file:=/nowhere.yaml", "/nowhere.yaml: cannot be read"),
    (
        OPTIMIZER_NODE,
        f"{LIGHT} -p stroke_low_m:=0.09 -p stroke_high_m:=0.01",
        "bounds: stroke from 0.09 to 0.01 m",
    ),
    (
        OPTIMIZER_NODE,
        f"{LIGHT} -p limits.servo_model:=XM430-W350",
        "without the driver's parameter file",
    ),
    (PLAY, "no_bag", "no_bag does not exist"),
    (PLAY, "bag --rate 0", "--rate"),
    (PLAY, "bag --start 1000", "after the end"),
    (
        PLAY,
        "other_layout",
        "'/worm/power' is not played: the worm_msgs/msg/Power of the bag differs",
    ),
    (PLAY, "bag -p frobnicate:=1", "no parameter frobnicate"),
    (RECORD, "--note x", "KEY=VALUE"),
    (RECORD, "--parameters no.yaml", "no.yaml"),
    (RECORD, "--output .", "exists already"),
    (RECORD, "--snapshot -1", "negative"),
    (RECORD, "--snapshot nan", "finite"),
    (RECORD, "'a b'", "not a name of a topic"),
    (RECORD, "--note 'pipe=\udcff'", "UTF-8"),
    (RECORD, "-p frobnicate:=1", "no parameter frobnicate"),
    (TRACKER_NODE, "-p setup_file:=/none.yaml", "tracker: /none.yaml: "),
    (TRACKER_NODE, f"-p setup_file:={SETUP_FILE} -p source:=run.mp4", "source is 'run.mp4'"),
    (TWIN_NODE, "-p parameter_file:=bad.yaml", "did you mean rear_mass"),
    (VIRTUAL_ROBOT, "--directory r --fault fire", "no fault 'fire'"),
    (VIRTUAL_ROBOT, "--directory r --parameters /nowhere.yaml", "No such file"),
    (VIRTUAL_ROBOT, "--directory r --slope 91", "slope_deg"),
    (VIRTUAL_ROBOT, "--directory r --tether nan", "tether_n"),
    (VIRTUAL_ROBOT, "--directory /proc/robot", "choose another --directory"),
    (VIRTUAL_ROBOT, "--directory r -p frobnicate:=1", "no parameter frobnicate"),
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("input")
    write_bag(made / "bag", simulated_run(cycles=1))
    other = Topic("/worm/power", "worm_msgs/msg/Power", 0, "float32 power\n", "ros2msg", "cdr")
    with new_bag(made / "other_layout") as writer:
        writer.write(other, b"\0\1\0\0" + bytes(4), 1, 1)
    (made / "bad.yaml").write_text("rear_mas: 1\n")
    (made / "gaits.csv").write_text("stroke_m,frequency_Hz\n0.07,0.2\n")
    (made / "s.yaml").write_text(SMALL)
    for name, wrong in {"misspelt": "prot: x", "twins": "fin_servos: {ids: [1, 2]}"}.items():
        text = f"/**/driver: {{ros__parameters: {{{wrong}}}}}\n"
        (made / f"{name}.yaml").write_text(text)
    for name in ("begun/promised.json", "complete/promised.json", "complete/report/report.html"):
        (made / name).parent.mkdir(parents=True, exist_ok=True)
        (made / name).touch()
    return made


@pytest.mark.parametrize(("module", "arguments", "fact"), BAD)
def test_bad_input_is_one_line_and_status_2_and_leaves_nothing(
    module, arguments, fact, folder, run, monkeypatch, tmp_path
):
    before = sorted(folder.rglob("*"))
    monkeypatch.chdir(folder)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    status, out, err = run(importlib.import_module(module), *arguments.split())
    assert (status, out) == (2, "")
    # a busy computer computes for long enough to report it
    (line,) = [line for line in err.splitlines() if ": computing" not in line]
    assert fact in line
    assert sorted(folder.rglob("*")) == before


def main_of(executable: str) -> Callable[[], int]:
    """Return the ``main`` of a node, given as package and name, or of the module of a command."""
    if " " not in executable:
        return importlib.import_module(executable).main
    package, name = executable.split()
    return getattr(importlib.import_module(f"{package}.nodes.executables"), name)


@pytest.mark.parametrize(("executable", "arguments", "fact"), BAD_WITH_ROS)
def test_bad_input_of_an_executable_with_ros_is_status_2_and_no_traceback(
    executable, arguments, fact, folder, ros_domain, monkeypatch, capfd, caplog
):
    given, dash, parameters = arguments.partition("-p ")
    ros = ["--ros-args", *shlex.split(dash + parameters)] if dash else []
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["command", *shlex.split(given), *ros])
    monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
    try:
        status = main_of(executable)()
    except SystemExit as end:
        status = end.code
    reported = capfd.readouterr().err + caplog.text
    assert status == 2
    assert fact in reported
    assert "Traceback" not in reported
