# SPDX-License-Identifier: Apache-2.0
"""The band of power that a measurement is compared with."""

from worm_model.gait import Gait
from worm_model.parameters import PAPER, ParameterFile
from worm_optimizer.report.expectation import expect

# 2.7 and 2.1 % to either side, correlated with −0.97: estimated from the lab's eight runs
INTERVALS = {"bellows_damping": (839.1, 885.7), "power_factor": (3.152, 3.288)}
EXACT = {key: (value, value) for key, value in PAPER.as_dict().items()}


def band(correlations):
    content = ParameterFile(PAPER, {**EXACT, **INTERVALS}, correlations=correlations)
    power = expect(Gait(0.07, 0.2), content).bands.power
    return (power.high - power.low) / power.value


def test_a_known_correlation_of_damping_and_power_factor_narrows_the_band_of_power():
    free = band({})
    known = band({("bellows_damping", "power_factor"): -0.97})
    assert 0.03 < free < 0.06
    assert known < 0.45 * free
