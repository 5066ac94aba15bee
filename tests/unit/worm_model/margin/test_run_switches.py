# SPDX-License-Identifier: Apache-2.0
"""Grooves that a fin missed, from the last switches of all cycles."""

import numpy as np
import pytest

from worm_model.margin import run_switches
from worm_model.margin.fin_switch import NONE, Switches
from worm_model.margin.half_cycles import Fin, HalfCycle, Motion
from worm_model.parameters import PAPER

SHORTENING = 0.01  # m/s
LONGEST, SHORTEST = 0.29, 0.23


def contraction(cycle: int) -> HalfCycle:
    return HalfCycle(cycle, Fin.REAR, 0.0, 6.0, LONGEST, SHORTEST)


@pytest.mark.parametrize(("seen_at", "missing"), [(0.245, (1, 1, 1, 1)), (0.2323, (1, 0, 1, 1))])
def test_a_cycle_with_the_most_grooves_is_the_reference_although_its_switch_does_not_fit(
    monkeypatch: pytest.MonkeyPatch, seen_at: float, missing: tuple[int, ...]
):
    """Three cycles gain one groove, one gains two; where its last switch fits no pitch, it is excluded."""
    time = np.linspace(0.0, 6.0, 181)
    length = LONGEST - SHORTENING * time
    motion = Motion(time, np.zeros(181), length, length, 1e-4, 6.0)
    lengths = {1: 0.2496, 2: seen_at, 3: 0.2500, 4: 0.2494}

    def find(motion, half, parameters, count, usual=None):
        last = Switches(((LONGEST - lengths[half.cycle]) / SHORTENING,), 0.01)
        return last if usual is None else NONE

    monkeypatch.setattr(run_switches, "find_switches", find)
    halves = [contraction(cycle) for cycle in (1, 2, 3, 4)]
    assert run_switches._of_fin(motion, halves, [1, 2, 1, 1], PAPER).missing == missing
