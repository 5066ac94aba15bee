# SPDX-License-Identifier: Apache-2.0
"""Work of the cable, compared with a quadrature, where roots of the motion are zero or nearly zero."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples

from worm_model.gait import Gait, Profile
from worm_model.parameters import PAPER
from worm_model.simulation.kernel import guard
from worm_model.simulation.kernel.linear import (
    Coefficients,
    Wave,
    basis_at,
    derivative,
    is_resonant,
    roots_of,
    value,
)
from worm_model.simulation.kernel.work import cable_work
from worm_model.simulation.simulator import evaluate_gait, simulate

SLOW_BODY = PAPER.replace(front_mass=0.3, viscous_friction=20000.0, time_constant=10.0)
SHORT_CONTRACTION = Gait(
    0.07, 0.06, pretension=0.04, contraction_share=0.01, profile=Profile.TRAPEZOID
)


def test_power_at_a_zero_root_agrees_with_a_quadrature() -> None:
    result = evaluate_gait(SHORT_CONTRACTION, SLOW_BODY)
    trajectory = simulate(SHORT_CONTRACTION, SLOW_BODY)
    # Before each event and densely between them, because the power jumps at events.
    borders = [0.0, *(event.time for event in trajectory.events()), trajectory.duration]
    cycles = np.linspace(2.0, 5.0, 60_001) * SHORT_CONTRACTION.period
    times = np.unique(np.concatenate([cycles, [t for t in borders if t >= cycles[0]]]))
    power = np.trapezoid(trajectory.at(times).power, times) / (times[-1] - times[0])
    assert result.power == pytest.approx(power, rel=1e-4)
    assert result.power == pytest.approx(1.0987, abs=1e-4)


SIZES = st.floats(-3.0, 3.0)
ROBOTS = st.tuples(
    st.floats(0.05, 3.0),  # mass, kg
    st.floats(0.01, 30_000.0),  # friction, N·s/m
    st.sampled_from([0.0, 0.0, 1e-3, 66.0]),  # stiffness, N/m: zero roots, slow roots
    st.floats(0.001, 10.0),  # time constant, s
)


@examples(100)
@given(ROBOTS, st.lists(SIZES, min_size=9, max_size=9), st.floats(0.0, 0.5), st.floats(0.01, 0.6))
def test_work_agrees_with_a_quadrature_for_zero_and_slow_roots(
    robot: tuple[float, float, float, float], sizes: list[float], offset: float, duration: float
) -> None:
    mass, friction, stiffness, time_constant = robot
    roots = roots_of(mass, friction, stiffness)
    wave = Wave(mass, 0.0, -1.0 / time_constant)
    resonant = is_resonant(roots, wave.q)
    one, slope, exp, *rest = sizes
    length_change = Coefficients(0.0, one, 0.5 * slope, 0.0, 0.0, 0.0, exp, 0.0, 0.0, 0.0)
    rate = derivative(length_change, roots, wave)
    force = Coefficients(*rest[:3], 0.0, 0.0, 0.0, *rest[3:], mass * friction if resonant else 0.0)

    def basis(s: float):
        return basis_at(offset + s, s, roots, wave, resonant)

    def antiderivative(s: float) -> float:
        return cable_work(length_change, rate, force, basis(s), s, wave, roots)

    # Steps that resolve the fastest root
    scale = min(duration, 1.0 / (abs(roots.r2) + math.sqrt(abs(roots.discriminant)) - wave.q))
    near = np.geomspace(1e-3 * scale, duration, 40)
    borders = np.concatenate([[0.0], near])
    nodes, weights = np.polynomial.legendre.leggauss(12)
    total = size = 0.0
    for low, high in itertools.pairwise(borders):
        for node, weight in zip(nodes, weights, strict=True):
            b = basis(0.5 * (low + high) + 0.5 * (high - low) * node)
            power = 0.5 * (high - low) * weight * value(force, b) * value(rate, b)
            total, size = total + power, size + abs(power)
    work = antiderivative(duration) - antiderivative(0.0)
    assert work == pytest.approx(total, rel=0, abs=1e-6 * size + 1e-9)


# Robots whose motion exceeds double precision: the work of a mode is lost among the digits of its antiderivative.
BEYOND = (
    (
        PAPER.replace(rear_mass=2.9162, front_mass=0.059622, viscous_friction=20769.0, time_constant=10.0),
        Gait(0.095884, 2.0557, 1, 0.0, 0.0077588, 0.012671, Profile.TRAPEZOID, 0.4991),
    ),
    (
        PAPER.replace(rear_mass=0.046644, front_mass=2.88271, viscous_friction=109.84, time_constant=10.0),
        Gait(0.071973, 2.66634, 1, 0.0, 0.0, 0.027861, Profile.TRAPEZOID, 0.11193),
    ),
)  # fmt: skip


@pytest.mark.parametrize(("parameters", "gait"), BEYOND)
def test_power_is_not_below_the_idle_power(parameters, gait) -> None:
    assert evaluate_gait(gait, parameters).power >= parameters.idle_power
    times = np.linspace(0.0, 5.0 * gait.period, 3001)
    motions = simulate(gait, parameters).at(times)
    cable_energy = motions.energy - parameters.idle_power * times
    assert cable_energy.min() >= 0.0


def test_a_border_that_rounding_hides_is_met_at_the_time_of_its_basis() -> None:
    roots, wave = roots_of(2.46, 24_600.0, 66.0), Wave(2.46, 0.0, -40.9)
    # Two terms of 1e8 m cancel, so that the tolerance is below the rounding errors.
    position = Coefficients(-1e8, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e8, 0.0, 0.0)
    rate = derivative(position, roots, wave)
    followed = guard.Followed(position, rate, derivative(rate, roots, wave), 0.0)
    start = basis_at(0.0, 0.0, roots, wave, False)
    for border in np.linspace(-17_000.1, -2_000.3, 20):
        ahead = guard.Horizon(1e-3, 0.2, guard.REAR_LOW)
        s, b = guard.locate(followed, border, 1e-14, 0.0, start, ahead, 0.0, roots, wave, False)
        assert b == basis_at(s, s, roots, wave, False)
