# SPDX-License-Identifier: Apache-2.0
"""The paper's own procedure finds the true parameters of runs without noise."""

import numpy as np
import pytest

from worm_model.analysis.simulated_run import simulated_run
from worm_model.errors import IdentificationError
from worm_model.gait import Gait
from worm_model.identification.data.observed_run import recording_of
from worm_model.identification.inputs import BenchTest, Inputs
from worm_model.identification.paper_procedure import literal
from worm_model.parameters import PAPER

GAITS = (Gait(0.07, 0.3), Gait(0.08, 0.15), Gait(0.08, 0.25))
TRUTH = PAPER.replace(
    viscous_friction=95.0, switching_threshold=0.0172, gain=0.84, slack=0.0071, time_constant=0.17
)


def test_it_finds_what_runs_without_noise_were_made_with():
    recordings = [
        recording_of(simulated_run(gait, TRUTH, 5, 60.0).as_recorded(), f"run_{k}")
        for k, gait in enumerate(GAITS)
    ]
    known = PAPER.replace(one_sided_cable=True)
    p, costs = literal(Inputs(tuple(recordings), None, None, None), known)
    assert not p.one_sided_cable
    assert p.viscous_friction == pytest.approx(TRUTH.viscous_friction, rel=0.03)
    assert p.switching_threshold == pytest.approx(TRUTH.switching_threshold, abs=5e-5)
    assert p.initial_length == pytest.approx(TRUTH.initial_length, abs=1e-9)
    for key in ("slack", "gain", "time_constant"):
        assert getattr(p, key) == pytest.approx(getattr(TRUTH, key), rel=2e-3)
    assert p.idle_power == pytest.approx(TRUTH.idle_power)
    # The smoothed length has a smaller rate at its corners, for which damping and factor compensate.
    assert p.bellows_damping == pytest.approx(TRUTH.bellows_damping, rel=0.15)
    assert p.power_factor == pytest.approx(TRUTH.power_factor, rel=0.15)
    assert costs["J_loc"] < (1e-4) ** 2
    assert costs["J_act"] < (1e-5) ** 2


def test_the_engaging_side_of_the_fin_test_can_be_given():
    displacement = np.linspace(-0.02, 0.02, 81)
    beyond = np.maximum(np.abs(displacement) - 0.5 * PAPER.clearance, 0.0)
    force = PAPER.engaged_stiffness * np.sign(displacement) * beyond  # both sides are alike
    force += np.random.default_rng(3).normal(0.0, 0.02, force.size)
    run = recording_of(simulated_run(GAITS[0], TRUTH, 5, 60.0).as_recorded(), "run_0")
    inputs = Inputs((run,), None, BenchTest(displacement, force, ""), None)
    with pytest.raises(IdentificationError, match="--fin-engages"):
        literal(inputs, PAPER)
    p, _ = literal(inputs, PAPER, fin_engages=1)
    assert p.engaged_stiffness == pytest.approx(PAPER.engaged_stiffness, rel=0.02)
