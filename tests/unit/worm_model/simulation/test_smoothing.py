# SPDX-License-Identifier: Apache-2.0
"""The documented smoothing, and the bias of power from a sampled length."""

import numpy as np
import pytest

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import Locomotion, simulate
from worm_model.simulation.smoothing import HALF_WINDOW, smooth


def test_a_parabola_comes_back_whatever_the_sampling() -> None:
    rng = np.random.default_rng(1)
    times = np.sort(rng.uniform(0.0, 10.0, 400))
    values = 0.3 - 0.02 * times + 0.001 * times**2
    smoothed = smooth(times, values, at=np.linspace(1.0, 9.0, 50))
    assert smoothed.value == pytest.approx(
        0.3 - 0.02 * smoothed.time + 0.001 * smoothed.time**2, abs=1e-10
    )
    assert smoothed.rate == pytest.approx(-0.02 + 0.002 * smoothed.time, abs=1e-8)


def test_slope_of_a_sinusoid_is_short_by_the_stated_factor() -> None:
    times = np.arange(0.0, 20.0, 1e-3)
    omega = 2.0 * np.pi * 0.4
    smoothed = smooth(times, np.sin(omega * times), at=np.linspace(5.0, 15.0, 200))
    factor = (omega * np.cos(omega * smoothed.time)) @ smoothed.rate
    factor /= np.sum((omega * np.cos(omega * smoothed.time)) ** 2)
    assert 1.0 - factor == pytest.approx((omega * HALF_WINDOW) ** 2 / 10.0, rel=0.05)


def test_missing_samples_are_skipped_and_gaps_not_bridged() -> None:
    times = np.arange(0.0, 6.0, 1.0 / 30.0)
    values = 0.1 * times
    values[40:44] = np.nan
    values[100:130] = np.nan
    smoothed = smooth(times, values)
    assert smoothed.value[42] == pytest.approx(0.1 * times[42])
    assert np.isnan(smoothed.value[115])
    assert np.isnan(smoothed.rate[115])
    assert np.all(np.isnan(smooth(times, np.full_like(times, np.nan)).value))


def test_causal_window_uses_no_later_sample() -> None:
    times = np.arange(0.0, 3.0, 0.02)
    values = np.sin(times)
    changed = np.where(times > 1.5, 99.0, values)
    one = smooth(times, values, at=[1.5], after=0.0)
    other = smooth(times, changed, at=[1.5], after=0.0)
    assert one.rate == pytest.approx(other.rate, abs=1e-12)


def test_times_that_do_not_ascend_are_rejected() -> None:
    with pytest.raises(ValueError, match="ascend"):
        smooth([0.0, 1.0, 0.5], [1.0, 2.0, 3.0])


@pytest.mark.parametrize(("frequency", "bias"), [(0.15, -0.0033), (0.2, -0.0065), (0.4, -0.029)])
def test_bias_of_power_from_a_camera_is_the_stated_one(frequency: float, bias: float) -> None:
    gait = Gait(0.09 if frequency == 0.4 else 0.0755 if frequency == 0.15 else 0.07, frequency)
    trajectory = simulate(gait)
    times = np.arange(0.0, trajectory.duration, 1.0 / 30.0)
    exact = trajectory.at(times)
    smoothed = smooth(times, exact.length - PAPER.initial_length)
    model = Locomotion()
    _, seen = model.follow_polynomial(model.start(), *smoothed.cubic(), times)
    averaged = times >= 2.0 * gait.period
    energy = np.trapezoid(seen.power[averaged], times[averaged])
    truth = exact.energy[averaged][-1] - exact.energy[averaged][0]
    assert energy / truth - 1.0 == pytest.approx(bias, abs=0.0015)
