# SPDX-License-Identifier: Apache-2.0
"""Grooves that a fin missed, from the last switches of all cycles."""

from collections.abc import Mapping, Sequence
from itertools import product

import numpy as np
import pytest

from worm_model.margin import run_switches
from worm_model.margin.fin_switch import NONE, Switches
from worm_model.margin.half_cycles import Fin, HalfCycle, Motion
from worm_model.parameters import PAPER

SHORTENING = 0.01  # m/s
LONGEST, SHORTEST = 0.29, 0.23


def missing(
    monkeypatch: pytest.MonkeyPatch, lengths: Mapping[int, float], counts: Sequence[int]
) -> tuple[int, ...]:
    """Return the missing grooves of contractions whose last switches are seen at these body lengths (m)."""
    time = np.linspace(0.0, 6.0, 181)
    length = LONGEST - SHORTENING * time
    motion = Motion(time, np.zeros(181), length, length, 1e-4, 6.0)

    def find(motion, half, parameters, count, usual=None):
        last = Switches(((LONGEST - lengths[half.cycle]) / SHORTENING,), 0.01)
        return last if usual is None else NONE

    monkeypatch.setattr(run_switches, "find_switches", find)
    halves = [contraction(cycle) for cycle in lengths]
    return run_switches._of_fin(motion, halves, counts, PAPER).missing


def contraction(cycle: int) -> HalfCycle:
    return HalfCycle(cycle, Fin.REAR, 0.0, 6.0, LONGEST, SHORTEST)


@pytest.mark.parametrize("missed", list(product((0, 1), repeat=4))[:-1])
def test_cycles_that_missed_a_groove_are_found_whichever_they_are(
    monkeypatch: pytest.MonkeyPatch, missed: tuple[int, ...]
):
    """Also where half of the cycles missed it, so that the median of the lengths is between two switches."""
    lengths = {k: 0.2323 + 0.0002 * k + PAPER.pitch * m for k, m in enumerate(missed, 1)}
    assert missing(monkeypatch, lengths, [2 - m for m in missed]) == missed


@pytest.mark.parametrize(("seen_at", "missed"), [(0.245, (1, 1, 1, 1)), (0.2323, (1, 0, 1, 1))])
def test_a_cycle_with_the_most_grooves_is_the_reference_although_its_switch_does_not_fit(
    monkeypatch: pytest.MonkeyPatch, seen_at: float, missed: tuple[int, ...]
):
    """Three cycles gain one groove, one gains two; where its last switch fits no pitch, it is excluded."""
    lengths = {1: 0.2496, 2: seen_at, 3: 0.2500, 4: 0.2494}
    assert missing(monkeypatch, lengths, [1, 2, 1, 1]) == missed
