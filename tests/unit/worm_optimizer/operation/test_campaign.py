# SPDX-License-Identifier: Apache-2.0
"""The validation campaign, as far as it needs no robot."""

import dataclasses
import json
import math
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from recorded_run import GAIT, simulated_run, write_bag

from worm_model.commands.command_line import finite
from worm_model.gait import named_values
from worm_model.parameters import PAPER, ParameterFile
from worm_msgs.conditions import Conditions
from worm_optimizer.commands import campaign as command
from worm_optimizer.operation import identification_runs
from worm_optimizer.operation.bring_up import left_out
from worm_optimizer.operation.campaign_plan import (
    PROMISES,
    is_promised,
    make_plan,
    with_comparisons,
    write_promises,
)
from worm_optimizer.operation.campaign_runs import (
    is_recorded,
    put_aside,
    run_gaits,
)
from worm_optimizer.operation.processes import ProcessError
from worm_optimizer.operation.system import Robot, load_system_file
from worm_optimizer.report.agreement import title_of
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.exact import Resolution
from worm_optimizer.search.search_settings import ScanSettings, Settings, Waveform

FILE = load_system_file(Path(__file__).parents[4] / "src/worm_optimizer/config/system.yaml")


@pytest.fixture(scope="module")
def quick() -> Settings:
    return Settings(
        margin=0.001,
        scan=ScanSettings(0.0, 0.002, 0.001),
        resolution=Resolution(21, 17),
        samples=20,
    )


@pytest.fixture(scope="module")
def plan():
    coarse = Settings(
        margin=0.0034,
        scan=ScanSettings(0.003, 0.004, 0.0005),
        resolution=Resolution(21, 17),
        samples=20,
    )
    return make_plan(ParameterFile(), coarse, 1)


def run_command(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["campaign", *arguments])
    return command.main()


def test_the_plan_has_the_papers_three_gaits_by_rising_speed(plan):
    assert list(plan.gaits) == ["min_power", "cruise", "max_speed"]
    speeds = [gait.nominal_speed for gait in plan.gaits.values()]
    assert speeds == sorted(speeds)
    assert {gait.margin for gait in plan.gaits.values()} == {0.0034}


def test_a_margin_as_a_load_is_that_of_all_gaits_of_the_plan(quick):
    loaded = dataclasses.replace(quick, margin=None, margin_force=0.5)
    plan = make_plan(ParameterFile(), loaded, 1)
    margin = 0.5 / (PAPER.engaged_stiffness + PAPER.disengaged_stiffness)
    compared = with_comparisons(plan, ParameterFile(), loaded, 1, nominal=True)
    assert plan.optimisation.front.margin == pytest.approx(margin)
    assert {gait.margin for gait in plan.gaits.values()} == {plan.optimisation.front.margin}
    assert len(compared.gaits) == 2 * len(plan.gaits)


def test_under_conditions_each_gait_is_followed_by_the_one_for_level_ground(quick):
    steep = dataclasses.replace(quick, conditions=Conditions(slope_deg=20.0, tether_n=2.0))
    plan = make_plan(ParameterFile(), steep, 1)
    compared = with_comparisons(plan, ParameterFile(), steep, 1, nominal=False)
    names = ["min_power", "cruise", "max_speed"]
    assert list(compared.gaits) == [each for name in names for each in (name, f"level_{name}")]
    level = compared.gaits["level_cruise"]
    designed = make_plan(ParameterFile(), quick, 1).gaits["cruise"]
    assert level.gait == designed.gait
    assert level.nominal_speed < designed.nominal_speed  # predicted under the load
    assert compared.gaits["cruise"].nominal_speed > level.nominal_speed
    assert title_of("level_cruise") == "cruising, for level ground"


def test_each_shaped_gait_is_followed_by_the_one_of_the_papers_waveform(quick):
    plan = make_plan(ParameterFile(), quick, 1)
    shaped = dataclasses.replace(quick, waveform=Waveform.SHAPED)
    compared = with_comparisons(plan, ParameterFile(), shaped, 1, nominal=False)
    names = ["min_power", "cruise", "max_speed"]
    assert list(compared.gaits) == [each for name in names for each in (name, f"sinusoid_{name}")]
    assert compared.gaits["sinusoid_cruise"].gait == plan.gaits["cruise"].gait


def test_promises_of_a_gait_that_does_not_move_are_json(plan, tmp_path: Path):
    still = dataclasses.replace(plan.gaits["cruise"], cost_of_transport=math.inf)
    path = write_promises(dataclasses.replace(plan, gaits={"cruise": still}), tmp_path)
    content = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert content["cruise"]["cost_of_transport"] is None


def test_promises_are_written_once(plan, tmp_path: Path):
    path = write_promises(plan, tmp_path)
    content = json.loads(path.read_text())
    assert content["cruise"] == finite(named_values(plan.gaits["cruise"]))
    with pytest.raises(FileExistsError):
        write_promises(plan, tmp_path)


@pytest.mark.parametrize("mode", ["virtual", "robot"])
def test_the_same_nodes_run_but_for_the_robot_itself(mode: str):
    robot = Robot(FILE, mode, {})
    names = [node.name for node in robot.system().nodes]
    assert names == [*(["virtual_robot"] if mode == "virtual" else []), "twin", "driver"]
    recorder = robot.recording_system(Path("/tmp/a bag")).node("recorder")
    assert recorder.arguments[:2] == ("--output", "/tmp/a bag")
    # the recorder starts without waiting for these topics
    assert left_out(recorder) == "^/worm/camera/"


def test_a_calibrated_driver_gets_its_file():
    arguments = (
        Robot(FILE, "robot", {"driver_file": "driver.yaml"}).system().node("driver").arguments
    )
    assert arguments == ("--ros-args", "--params-file", "driver.yaml")
    assert Robot(FILE, "robot", {}).system().node("driver").arguments == ()


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (("--set", "port"), "write NAME=VALUE"),
        (("--set", "prot=/dev/ttyUSB0"), "no setting 'prot'"),
        (("--margin", "-1"), "margin: -1"),
        (("--slope", "91"), "slope_deg: 91"),
        (("--tether-length", "1"), "tether_n_per_m"),
        (("--set", "slope_deg=steep"), "steep"),
        (("--parameters", "none.yaml"), "none.yaml: cannot be read"),
        (("--mode", "imaginary"), "invalid choice"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture,
    arguments: tuple[str, ...],
    complaint: str,
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    try:
        status = run_command(monkeypatch, *arguments, "--output", "folder")
    except SystemExit as end:  # of argparse
        status = end.code
    assert status == 2
    reported = capsys.readouterr()
    assert complaint in reported.err.splitlines()[-1]
    assert not (tmp_path / "folder").exists()


def test_an_existing_folder_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
):
    (tmp_path / "folder").mkdir()
    assert run_command(monkeypatch, "--output", str(tmp_path / "folder")) == 2
    assert "exists already" in capsys.readouterr().err
    assert list((tmp_path / "folder").iterdir()) == []


# --- interrupted campaign ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "cruise", simulated_run())


def test_a_gait_counts_as_recorded_from_its_onset_to_the_end_of_its_last_cycle(bag, tmp_path: Path):
    assert is_recorded(bag)
    assert not is_recorded(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert not is_recorded(tmp_path / "empty")
    run = simulated_run()
    states, tracker = run.gait_state, run.tracker
    broken_off = dataclasses.replace(
        run, gait_state=type(states)(**{k: v[:-1] for k, v in vars(states).items()})
    )
    assert not is_recorded(write_bag(tmp_path / "broken_off", broken_off))
    half = tracker.stamp.size // 2
    unseen = dataclasses.replace(
        run, tracker=type(tracker)(**{k: v[:half] for k, v in vars(tracker).items()})
    )
    assert not is_recorded(write_bag(tmp_path / "unseen", unseen))


def test_what_is_recorded_is_not_run_again(bag, tmp_path: Path):
    """No node is started: none is configured."""
    nothing = dataclasses.replace(FILE, nodes={})
    reported: list[str] = []
    orders = {"cruise": GaitCommand(GAIT, 5)}
    run_gaits(
        Robot(nothing, "virtual", {}), orders, bag.parent, tmp_path / "no_logs", reported.append
    )
    assert reported == ["cruise: recorded already"]


def test_an_unfinished_recording_is_kept_under_another_name(tmp_path: Path):
    for number in (1, 2):
        (tmp_path / "cruise").mkdir()
        (tmp_path / "cruise" / "mark").write_text(str(number))
        put_aside(tmp_path / "cruise", lambda _: None)
    put_aside(tmp_path / "cruise", lambda _: None)
    kept = {path.name: (path / "mark").read_text() for path in tmp_path.iterdir()}
    assert kept == {"cruise_unfinished_1": "1", "cruise_unfinished_2": "2"}


def test_a_folder_goes_on_only_with_the_gaits_it_was_begun_with(plan, tmp_path: Path):
    write_promises(plan, tmp_path)
    assert is_promised(plan, tmp_path)
    other = {name: gait for name, gait in plan.gaits.items() if name != "cruise"}
    assert not is_promised(dataclasses.replace(plan, gaits=other), tmp_path)


@pytest.mark.parametrize(
    ("make", "arguments", "complaint"),
    [
        ([], [], "contains no campaign"),
        (["promised.json"], ["--output", "x"], "remove --output"),
        (["promised.json", "report/report.html"], [], "is complete"),
    ],
)
def test_what_cannot_be_resumed_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys, make, arguments, complaint
):
    for name in make:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert run_command(monkeypatch, "--resume", str(tmp_path), *arguments) == 2
    assert complaint in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize("status", [0, 1])
def test_bench_tests_that_are_interrupted_leave_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: int
):
    code = "import pathlib, sys; p = pathlib.Path(sys.argv[1]); p.mkdir(); (p / 'fin.csv').touch()"
    monkeypatch.setattr(
        identification_runs,
        "executable_command",
        lambda *_: [sys.executable, "-c", f"{code}; sys.exit({status})"],
    )
    folder, logs = tmp_path / "campaign", tmp_path / "logs"
    folder.mkdir()
    logs.mkdir()
    robot = Robot(FILE, "virtual", {})
    if status == 0:
        assert identification_runs.virtual_bench(robot, folder, logs).fin.is_file()
    else:
        with pytest.raises(ProcessError):
            identification_runs.virtual_bench(robot, folder, logs)
    assert [path.name for path in folder.iterdir()] == ["bench_tests"] * (status == 0)


def test_only_a_campaign_that_has_begun_can_be_continued(tmp_path: Path):
    options = SimpleNamespace(identify=False)
    assert command._hint(options, tmp_path / "campaign") == ""
    (tmp_path / "campaign").mkdir()
    assert command._hint(options, tmp_path / "campaign") == ""
    (tmp_path / "campaign" / PROMISES).touch()
    assert "--resume" in command._hint(options, tmp_path / "campaign")
