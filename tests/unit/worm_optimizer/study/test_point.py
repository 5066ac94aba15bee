# SPDX-License-Identifier: Apache-2.0
import dataclasses

import numpy as np
import pytest
from study_cases import small_study

from worm_model.errors import InputError
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.closed_form import groove_phase
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.gait import Gait
from worm_optimizer.evaluation.task import MarginTask
from worm_optimizer.search.front import front_of_task
from worm_optimizer.study.point import (
    DONE,
    FAILED,
    compute_block,
    compute_point,
    content_of,
    dimensions,
    task_of,
)
from worm_optimizer.study.study_file import LIMITS

STUDY = small_study()
POINTS = STUDY.points()


def test_the_gaits_are_those_of_the_front_of_the_point():
    found = compute_point(
        STUDY, {"parameter_file": 0, "slack": 0.004, "switching_threshold": 0.0175}
    )
    robot = PAPER.replace(slack=0.004)
    front = front_of_task(MarginTask(robot, margin=0.002), STUDY.file.resolution.scan).front
    assert dimensions(STUDY)["gait"] == ["min_power", "cruise", "max_speed", "max_speed_at_power"]
    assert found["speed"][2] == front.speed.max()
    assert found["power"][0] == front.power.min()
    assert found["front_size"] == len(front)
    # each value is the simulator's for that gait
    for k in range(4):
        gait = Gait(found["stroke"][k], found["frequency"][k], margin=0.002)
        assert found["power"][k] == pytest.approx(evaluate_gait(gait, robot).power, rel=1e-12)
        nominal = evaluate_gait(dataclasses.replace(gait, margin=0.0), robot)
        assert found["nominal_speed"][k] == pytest.approx(nominal.speed, rel=1e-12)
    assert found["power"][3] <= 2.6
    assert all(
        speed <= found["speed"][3]
        for speed, power in zip(front.speed, front.power, strict=True)
        if power <= 2.6
    )


def test_a_point_that_is_not_admissible_has_a_reason_and_the_others_stay():
    results = compute_block(STUDY, POINTS)
    assert results["state"].tolist() == [FAILED, DONE] * 3
    assert "less than half the pitch" in results["reason"][0]
    assert np.isnan(results["speed"][0]).all()
    assert np.isfinite(results["speed"][1]).all()


def test_the_groove_phase_can_be_held_while_the_pitch_varies():
    robots = [
        content_of(STUDY, {"pitch": pitch, "groove_phase_m": 0.001}).parameters
        for pitch in (0.015, 0.0173, 0.019)
    ]
    assert [groove_phase(robot) for robot in robots] == pytest.approx([0.001] * 3, abs=1e-12)
    with pytest.raises(InputError, match="not within half a pitch"):
        content_of(STUDY, {"groove_phase_m": 0.02})


def test_a_value_of_the_other_sign_keeps_the_order_of_its_interval():
    content = ParameterFile(
        PAPER.replace(rear_load=0.5), {"rear_load": (0.4, 0.7)}, run_to_run={"rear_load": 0.05}
    )
    study = dataclasses.replace(STUDY, robots=(("robot", content),))
    robot = content_of(study, {"rear_load": -0.5})
    assert robot.intervals["rear_load"] == pytest.approx((-0.7, -0.4))
    assert robot.run_to_run["rear_load"] == pytest.approx(0.05)


def test_a_fixed_limit_is_that_of_the_task():
    limits = {name: 1.0 + place for place, name in enumerate(LIMITS)}
    task = task_of({**limits, "max_stroke_m": 0.08}, PAPER)
    assert dataclasses.astuple(task.limits) == tuple(limits.values())
    assert task.limits.pushing_force == limits["max_push_force_N"]
    assert task.bounds.stroke_high == 0.08


def test_cliff_success_and_any_phase():
    study = small_study(
        compute=["gaits", "success", "any_phase"],
        fixed=None,
        scan={"lowest_m": 0.003, "highest_m": 0.004, "step_m": 0.0002},
    )
    found = compute_point(
        study, {"parameter_file": 0, "slack": 0.008, "switching_threshold": 0.0175}
    )
    assert found["cliff_margin"] == pytest.approx(0.0034, abs=2.1e-4)
    assert found["margin"] <= found["cliff_margin"] <= found["margin"] + 5e-4
    assert found["closed_form_cliff_margin"] == pytest.approx(0.0034, abs=1e-4)
    assert len(found["scan_cost_of_transport"]) == len(dimensions(study)["scan_margin"]) == 6
    success = found["success_probability"]
    assert ((success >= 0.0) & (success <= 1.0))[np.isfinite(success)].all()
    assert found["any_phase_grooves_per_cycle"][2] >= 1.0


def test_a_point_on_which_no_gait_moves_has_no_margin_at_the_cliff_and_has_not_failed():
    scan = {"lowest_m": 0.003, "highest_m": 0.004, "step_m": 0.0005}
    block = compute_block(small_study(fixed={"tether_n": 30}, scan=scan), POINTS[1:2])
    assert (block["state"][0], block["reason"][0]) == (DONE, "")
    assert np.isnan(block["margin"][0])
    assert np.isnan(block["speed"][0]).all()
