# SPDX-License-Identifier: Apache-2.0
"""The pull test: loads of virtual robots with uneven grooves and dry friction, on imprecisely known robots."""

import dataclasses
from functools import lru_cache

import numpy as np
import pytest
from virtual_campaign import read_off, run_of

from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.commands.command_line import run_command
from worm_model.commands.identify import _parser, _run
from worm_model.gait import Gait
from worm_model.identification.data.observed_run import recording_of
from worm_model.identification.inputs import Inputs
from worm_model.identification.pull_test import PullTest, estimate_rear_load, loaded_file
from worm_model.identification.reference_values import ReferenceValues
from worm_model.parameters import ParameterFile, Parameters
from worm_msgs.conditions import Conditions

PLAN = ((Gait(0.08, 0.25), 12.0), (Gait(0.07, 0.2), 17.0))  # gait, s
#: 95 % bounds of the known robot, relative
KNOWN = {
    "viscous_friction": 0.05,
    "switching_threshold": 0.01,
    "clearance": 0.01,
    "engaged_stiffness": 0.015,
    "disengaged_stiffness": 0.015,
}
PITCH_M = 5e-5
CASES = ((1, 2.0), (2, 0.0), (3, 4.0), (4, 1.0), (5, 0.5), (6, 3.0))  # seed, N


def known_robot(truth: Parameters, random: np.random.Generator) -> ReferenceValues:
    values, intervals = {}, {}
    for key, relative in KNOWN.items():
        half = relative * getattr(truth, key)
        values[key] = getattr(truth, key) + half / 1.96 * random.standard_normal()
        intervals[key] = values[key] - half, values[key] + half
    parameters = read_off(truth, random).replace(**values)
    intervals["pitch"] = parameters.pitch - PITCH_M, parameters.pitch + PITCH_M
    return ReferenceValues(parameters, intervals, "a test")


@lru_cache
def pulled(seed: int, load: float) -> PullTest:
    settings = dataclasses.replace(
        load_settings(),
        seed=seed,
        parameter_spread=0.05,
        conditions=Conditions(tether_n=load),
    )
    recordings = []
    for number, (gait, duration) in enumerate(PLAN):
        own = dataclasses.replace(settings, recording=number + 1)
        command = gait.length_change
        run = run_offline(own, command, duration)
        recordings.append(recording_of(run_of(run, gait, settings), f"run_{number}"))
    truth = Parameters(**dataclasses.asdict(run.truth))
    reference = known_robot(truth, np.random.default_rng([seed, 7]))
    return estimate_rear_load(Inputs(tuple(recordings), None, None, None), reference)


def test_the_interval_covers_the_load_on_nearly_every_robot():
    """If 95 % of intervals cover, more than one miss in six has a probability of 3 %."""
    results = [(pulled(seed, load).load, load) for seed, load in CASES]
    covered = [estimate.low <= load <= estimate.high for estimate, load in results]
    assert sum(covered) >= len(CASES) - 1
    assert all(abs(estimate.value - load) < 0.1 + 0.1 * load for estimate, load in results)
    assert all(estimate.spread < 0.1 + 0.1 * load for estimate, load in results)


def test_the_file_is_that_of_the_robot_under_its_load():
    result = pulled(*CASES[0])
    robot = ParameterFile(Parameters(), {"gain": (0.8, 0.9)}, {"made_by": "a test"})
    loaded = loaded_file(result, robot)
    assert loaded.parameters == Parameters(rear_load=result.load.value)
    assert loaded.intervals == {
        "gain": (0.8, 0.9),
        "rear_load": (result.load.low, result.load.high),
    }
    assert set(loaded.provenance["pull_test"]["runs"]) == {"run_0", "run_1"}
    assert len(result.residuals) == len(PLAN)
    assert max(result.residuals) < 5e-4


@pytest.mark.parametrize(
    ("options", "fact"),
    [
        ((), "--parameters"),
        (("--literal",), "--literal"),
        (("--report", "new"), "--report"),
        (("--fin-engages", "positive"), "--fin-engages"),
    ],
)
def test_what_contradicts_a_pull_test_is_rejected_in_one_line(
    options, fact, shared, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    run = shared / "campaign" / "run_08"
    assert run_command(_parser(), _run, [str(run), "--estimate", "rear_load", *options]) == 2
    err = capsys.readouterr().err.strip().splitlines()
    assert len(err) == 1
    assert fact in err[0]
