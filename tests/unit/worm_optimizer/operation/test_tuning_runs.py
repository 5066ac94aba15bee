# SPDX-License-Identifier: Apache-2.0
"""Tuning on robots that the model does not contain, with a fake operator instead of a node graph."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from foreign_robot import ForeignRobot, crawl, some_robot
from recorded_run import write_bag

from worm_model.errors import InputError
from worm_model.gait import Gait
from worm_model.run import Run, TrackerSamples
from worm_optimizer.commands.tune import Aim, measured_step
from worm_optimizer.operation.campaign_runs import (
    MOST_RUNS,
    TUNING,
    gait_recorder,
    tune_gait,
    tune_gaits,
)
from worm_optimizer.operation.system import Robot, load_system_file
from worm_optimizer.robustness.tuning import GaitLimits, TuneState, Tuning

FRAGILE = Gait(0.0713, 0.2)  # loses grooves on most foreign robots
LARGEST_M = 0.085
AIM = Aim(0.99, 2, GaitLimits(lambda _: LARGEST_M), "")
SYSTEM = load_system_file(Path(__file__).parents[4] / "src/worm_optimizer/config/system.yaml")
NO_NODES = Robot(dataclasses.replace(SYSTEM, nodes={}), "virtual", {})


class Operator:
    """Runs gaits on a foreign robot and records them."""

    def __init__(
        self, robot: ForeignRobot, folder: Path, seen: Callable[[Run], Run] = lambda run: run
    ) -> None:
        self.robot, self.folder, self.seen = robot, folder, seen
        self.gaits: list[Gait] = []

    def __call__(self, gait: Gait, number: int) -> Path:
        self.gaits.append(gait)
        run = crawl(self.robot, gait, seed=number).run
        return write_bag(self.folder / f"cruise_{number}", self.seen(run))


def step_of(aim: Aim, said: list[str]) -> Callable[[Sequence[Path]], Tuning]:
    return lambda bags: measured_step(bags, aim, said.append)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_fragile_gait_becomes_one_that_keeps_its_grooves(seed: int, tmp_path: Path):
    operator, said = Operator(some_robot(seed), tmp_path / TUNING), []
    tuned = tune_gait(FRAGILE, operator, step_of(AIM, said), said.append)
    assert tuned.step.state is TuneState.DONE
    assert 0.0 <= operator.gaits[-1].stroke - tuned.step.gait.stroke <= 0.0015
    assert tuned.step.gait.frequency == operator.gaits[-1].frequency
    assert tuned.step.keeps.value >= AIM.probability
    assert {bag.name for bag in tuned.bags} == {bag.name for bag in operator.folder.iterdir()}
    assert len(operator.gaits) <= MOST_RUNS
    assert all(gait.stroke <= LARGEST_M for gait in operator.gaits)
    cycles = crawl(operator.robot, tuned.step.gait, 12, seed=99).grooves(
        12, tuned.step.gait.frequency
    )
    assert set(cycles[1:]) == {2}
    assert f"run 1 of at most {MOST_RUNS}: 71.3 mm, 0.2 Hz" in said
    # a resumed campaign measures its recordings again, and starts no node: none is configured
    three = {"cruise": (FRAGILE, step_of(AIM, []))}
    with gait_recorder(NO_NODES, tmp_path / "no_logs", said.append) as record:
        assert tune_gaits(three, record, tmp_path, said.append) == {"cruise": tuned}
    assert "cruise_1: recorded already" in said


@pytest.mark.parametrize(("excess", "reason"), [(0.001, ""), (0.006, "--objective min_power")])
def test_no_run_exceeds_the_limits_and_an_unattainable_aim_is_impossible(
    excess: float, reason: str, tmp_path: Path
):
    """With the larger excess, the gait loses all grooves at any stroke within the limits."""
    aim = dataclasses.replace(AIM, limits=GaitLimits(lambda _: FRAGILE.stroke, FRAGILE.frequency))
    operator = Operator(some_robot(1, rear_excess=excess), tmp_path)
    tuned = tune_gait(FRAGILE, operator, step_of(aim, []), print)
    assert tuned.step.state is TuneState.IMPOSSIBLE
    assert reason in tuned.step.reason
    assert operator.gaits == [FRAGILE]


def test_where_the_front_fin_limits_the_stroke_is_only_what_the_rear_one_needs(tmp_path: Path):
    first = Gait(0.08, 0.2)
    operator = Operator(some_robot(3, cable_stiffness=20000.0), tmp_path)
    tuned = tune_gait(first, operator, step_of(AIM, []), print)
    assert tuned.step.state is TuneState.IMPOSSIBLE
    assert tuned.step.gait.stroke < first.stroke - 0.01
    assert len(operator.gaits) <= MOST_RUNS


def test_after_the_most_runs_the_next_gait_is_returned_and_not_run(tmp_path: Path):
    operator = Operator(some_robot(1), tmp_path)
    first = measured_step([operator(FRAGILE, 0)], AIM, print)
    endless = dataclasses.replace(first, state=TuneState.RUN)
    ran: list[Gait] = []

    def record(gait: Gait, number: int) -> Path:
        ran.append(gait)
        return Path(str(number))

    tuned = tune_gait(FRAGILE, record, lambda _: endless, print)
    assert ran == [FRAGILE, *[endless.gait] * (MOST_RUNS - 1)]
    assert (tuned.step, len(tuned.bags)) == (endless, MOST_RUNS)


def hidden(run: Run) -> Run:
    nothing = np.full(run.tracker.stamp.size, np.nan)
    return dataclasses.replace(run, tracker=TrackerSamples(run.tracker.stamp, nothing, nothing))


@pytest.mark.parametrize(
    ("gait", "seen", "remedy"),
    [
        (FRAGILE, hidden, "tracker must see both modules"),
        (Gait(0.04, 0.2), lambda run: run, "longer stroke"),  # without a groove
    ],
)
def test_a_run_without_a_margin_ends_the_tuning_with_the_remedy(
    gait: Gait, seen: Callable[[Run], Run], remedy: str, tmp_path: Path
):
    operator = Operator(some_robot(1), tmp_path, seen)
    with pytest.raises(InputError, match=remedy):
        tune_gait(gait, operator, step_of(AIM, []), print)
    assert len(operator.gaits) == 1


def test_a_slow_gait_whose_front_fin_lacks_margin_gets_less_pretension(tmp_path: Path):
    operator = Operator(some_robot(1, front_excess=0.003), tmp_path)
    first = Gait(0.065, 0.15, pretension=0.01)
    step = measured_step([operator(first, 1)], AIM, print)
    assert step.state is TuneState.RUN
    assert step.gait.pretension < first.pretension
    assert step.gait.frequency == first.frequency
    assert step.gait.reach <= LARGEST_M
