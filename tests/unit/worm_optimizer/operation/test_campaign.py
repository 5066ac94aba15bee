# SPDX-License-Identifier: Apache-2.0
"""The validation campaign, as far as it needs no robot."""

import dataclasses
import sys
from contextlib import nullcontext
from pathlib import Path

import pytest
from recorded_run import GAIT, simulated_run, write_bag

from worm_model.errors import InputError
from worm_model.parameters import ParameterFile
from worm_msgs.conditions import Conditions
from worm_optimizer.operation import identification_runs
from worm_optimizer.operation.campaign_plan import make_plan, promise
from worm_optimizer.operation.campaign_runs import is_recorded, put_aside, run_gaits
from worm_optimizer.operation.processes import ProcessError
from worm_optimizer.operation.system import Robot, load_system_file
from worm_optimizer.report.agreement import title_of
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.exact import Resolution
from worm_optimizer.search.search_settings import ScanSettings, Settings

FILE = load_system_file(Path(__file__).parents[4] / "src/worm_optimizer/config/system.yaml")


QUICK = Settings(
    margin=0.001, scan=ScanSettings(0.0, 0.002, 0.001), resolution=Resolution(21, 17), samples=20
)


@pytest.fixture(scope="module")
def plan():
    coarse = dataclasses.replace(QUICK, margin=0.0034, scan=ScanSettings(0.003, 0.004, 0.0005))
    return make_plan(ParameterFile(), coarse, 1)


def test_the_plan_has_the_papers_three_gaits_by_rising_speed(plan):
    assert list(plan.gaits) == ["min_power", "cruise", "max_speed"]
    speeds = [gait.nominal_speed for gait in plan.gaits.values()]
    assert speeds == sorted(speeds)
    assert {gait.margin for gait in plan.gaits.values()} == {0.0034}


def test_under_conditions_each_gait_is_followed_by_the_one_for_level_ground():
    steep = dataclasses.replace(QUICK, conditions=Conditions(slope_deg=20.0, tether_n=2.0))
    plan = make_plan(ParameterFile(), steep, 1)
    names = ["min_power", "cruise", "max_speed"]
    assert list(plan.gaits) == [each for name in names for each in (name, f"level_{name}")]
    level = plan.gaits["level_cruise"]
    designed = make_plan(ParameterFile(), QUICK, 1).gaits["cruise"]
    assert level.gait == designed.gait
    assert level.nominal_speed < designed.nominal_speed  # predicted under the load
    assert plan.gaits["cruise"].nominal_speed > level.nominal_speed
    assert title_of("level_cruise") == "cruising, for level ground"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_bag(tmp_path_factory.mktemp("bags") / "cruise", simulated_run())


def test_a_gait_counts_as_recorded_from_its_onset_to_the_end_of_its_last_cycle(bag, tmp_path: Path):
    assert is_recorded(bag)
    assert not is_recorded(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    assert not is_recorded(tmp_path / "empty")
    run = simulated_run()
    for part, kept in (("gait_state", -1), ("tracker", run.tracker.stamp.size // 2)):
        whole = getattr(run, part)
        begin = type(whole)(**{name: column[:kept] for name, column in vars(whole).items()})
        assert not is_recorded(
            write_bag(tmp_path / part, dataclasses.replace(run, **{part: begin}))
        )


def test_what_is_recorded_is_not_run_again(bag, tmp_path: Path):
    """No node is started: none is configured."""
    nothing = dataclasses.replace(FILE, nodes={})
    reported: list[str] = []
    robot, orders = Robot(nothing, "virtual", {}), {"cruise": GaitCommand(GAIT, 5)}
    run_gaits(robot, orders, bag.parent, tmp_path / "no_logs", reported.append)
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
    promise(plan, tmp_path)
    promise(plan, tmp_path)
    other = {name: gait for name, gait in plan.gaits.items() if name != "cruise"}
    with pytest.raises(InputError, match="has other predictions"):
        promise(dataclasses.replace(plan, gaits=other), tmp_path)


@pytest.mark.parametrize("status", [0, 1])
def test_bench_tests_that_are_interrupted_leave_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, status: int
):
    code = "import pathlib, sys; p = pathlib.Path(sys.argv[1]); p.mkdir(); (p / 'fin.csv').touch()"
    command = [sys.executable, "-c", f"{code}; sys.exit({status})"]
    monkeypatch.setattr(identification_runs, "executable_command", lambda *_: command)
    folder = tmp_path / "campaign"
    folder.mkdir()
    with pytest.raises(ProcessError) if status else nullcontext():
        files = identification_runs.virtual_bench(Robot(FILE, "virtual", {}), folder, tmp_path)
        assert files[1].is_file()
    assert [path.name for path in folder.iterdir()] == ["bench_tests"] * (status == 0)
