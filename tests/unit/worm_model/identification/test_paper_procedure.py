# SPDX-License-Identifier: Apache-2.0
"""The paper's own procedure finds the true parameters of runs without noise."""

import pytest

from worm_model.analysis.simulated_run import simulated_run
from worm_model.gait import Gait
from worm_model.identification.data.observed_run import recording_of
from worm_model.identification.inputs import Inputs
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
