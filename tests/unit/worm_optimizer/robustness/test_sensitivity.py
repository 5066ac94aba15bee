# SPDX-License-Identifier: Apache-2.0
"""Shares of the variance, compared with a closed form."""

import json

import numpy as np
import pytest

from worm_model.gait import Gait, Profile
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.simulator import evaluate_gait
from worm_msgs.robot_parameters import TravelError
from worm_optimizer.commands import sensitivity as command
from worm_optimizer.report.front_plots import sensitivity_figure
from worm_optimizer.robustness.sensitivity import Indices, Sensitivity, sensitivity

GAIT = Gait(0.0755, 0.15)
EXACT = {key: (value, value) for key, value in PAPER.as_dict().items()}


def of(**half_widths):
    own = {k: (getattr(PAPER, k) - w, getattr(PAPER, k) + w) for k, w in half_widths.items()}
    content = ParameterFile(PAPER, {**EXACT, **own}, travel_error=TravelError(0.0, 0.0))
    return sensitivity(GAIT, content, 512, 1)


def test_power_is_idle_power_and_a_factor_times_work():
    found = of(idle_power=0.05, power_factor=0.06)
    work = (evaluate_gait(GAIT).power - PAPER.idle_power) / PAPER.power_factor
    variances = np.array([0.05**2, (0.06 * work) ** 2])
    shares = dict(zip(("idle_power", "power_factor"), variances / variances.sum(), strict=True))
    power = found.indices["power"]
    for k, key in enumerate(found.parameters):
        assert power.first[k] == pytest.approx(shares[key], abs=0.06)
        assert power.total[k] == pytest.approx(shares[key], abs=0.06)
    assert power.mean == pytest.approx(evaluate_gait(GAIT).power, rel=0.01)
    assert power.deviation == pytest.approx(np.sqrt(variances.sum()) / 1.96, rel=0.1)


def test_what_does_not_vary_has_no_indices():
    found = of(idle_power=0.05)
    assert np.all(np.isnan(found.indices["speed"].total))
    assert found.indices["speed"].deviation == pytest.approx(0.0, abs=1e-12)


def test_error_bars_end_at_the_bounds_and_none_points_the_wrong_way():
    """The bounds of the first input exclude its estimate."""
    values, bounds = np.array([0.1, 0.5]), np.array([[0.2, 0.4], [0.3, 0.7]])
    indices = Indices(values, values, bounds, bounds, 1.0, 1.0)
    found = Sensitivity(GAIT, ("pitch", "idle_power"), {}, {"speed": indices, "power": indices}, 8)
    axes = sensitivity_figure(found).axes[0]
    ends = sorted(
        tuple(map(float, segment[:, 0]))
        for bars in axes.collections
        for segment in bars.get_segments()
    )
    assert ends == [pytest.approx(e) for e in ((0.1, 0.3), (0.1, 0.3), (0.4, 0.7), (0.4, 0.7))]


def test_the_speed_of_a_branch_is_decided_by_the_pitch():
    found = of(pitch=5e-5, idle_power=0.05)
    speed = dict(zip(found.parameters, found.indices["speed"].total, strict=True))
    assert speed["pitch"] == pytest.approx(1.0, abs=0.1)
    assert speed["idle_power"] == pytest.approx(0.0, abs=1e-9)


def test_the_travel_error_decides_the_cliff_of_a_robot_that_no_run_has_measured():
    found = sensitivity(GAIT, ParameterFile(), 256, 1)
    assert found.parameters[int(np.argmax(found.indices["cliff_margin"].total))] == "travel_error"


def test_no_impossible_share_is_printed_as_a_number():
    """Few samples give indices below 0 and above 1."""
    impossible = np.array([-0.055, 1.04, -1e-5, 1.0])
    bounds = np.stack([impossible - 0.1, impossible + 0.1])
    indices = Indices(impossible, impossible[::-1], bounds, bounds, 1.0, 1.0)
    cells = [command.index_cells(indices, row) for row in range(4)]
    assert [row[0] for row in cells] == ["< 0 %", "> 100 %", "0.0 %", "100.0 %"]
    assert [row[2] for row in cells] == ["100.0 %", "0.0 %", "> 100 %", "< 0 %"]
    assert cells[0][1] == "< 0 % to 4.5 %"
    assert cells[1][3] == "94.0 % to > 100 %"


def test_the_command(run, tmp_path):
    gait = ("--stroke", "0.0755", "--frequency", "0.15", "--samples")
    figure = tmp_path / "sensitivity.svg"
    status, reported, _ = run(command, *gait, "16", "--json", "--figure", str(figure))
    content = json.loads(reported)
    assert status == 0
    assert set(content["power"]["indices"]) == set(content["parameters"])
    assert figure.stat().st_size > 1000
    assert isinstance(content["warnings"], list)
    text = run(command, *gait, "16")[1]
    assert "-0.0 %" not in text
    assert text.count(" to ") >= 2  # bounds of each index
    shape = ("--pretension", "0.003", "--profile", "trapezoid", "--contraction-share", "0.8")
    shaped = json.loads(run(command, *gait, "16", *shape, "--json")[1])
    own = Gait(0.0755, 0.15, 1, 0.0, 0.003, 0.8, Profile.TRAPEZOID)
    assert shaped["power"]["mean"] == pytest.approx(evaluate_gait(own).power, rel=0.05)
